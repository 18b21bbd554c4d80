"""Maps of the ground in files and bags: known pixels, round trips, real messages, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import bags
import numpy as np
import pytest
from PIL import Image
from shared_data import shared_data

from maomaps_warp.errors import InputError
from maomaps_warp.io.bags import open_contents
from maomaps_warp.io.bags.occupancy import grid_of
from maomaps_warp.io.occupancy_maps import (
    holds_occupancy,
    read_occupancy,
    write_map_server,
    write_png,
    write_projection,
)
from maomaps_warp.model.occupancy import Cell, OccupancyGrid

U, F, X = int(Cell.UNKNOWN), int(Cell.FREE), int(Cell.OCCUPIED)
#: Two rows, the lower one first.
CELLS = np.array([[U, F, X], [X, X, F]], dtype=np.uint8)


def grid(cells=CELLS, resolution=0.05, origin=(-1.625, 2.5, 0.0)):
    return OccupancyGrid(cells, resolution, origin)


def write_yaml(path, image="map.png", **changes):
    fields = {
        "image": image,
        "resolution": "0.05",
        "origin": "[1.0, -2.0, 0.5]",
        "negate": "0",
        "occupied_thresh": "0.65",
        "free_thresh": "0.196",
        **changes,
    }
    path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items() if value is not None))
    return path


def write_image(path, pixels):
    """Grey, RGB or RGBA, by the shape of the pixels."""
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(path)
    return path


def read_pixels(folder, pixels, **changes):
    """Cells of a map_server pair with these pixels, upper row first as in the image."""
    write_image(folder / "map.png", pixels)
    return read_occupancy(write_yaml(folder / "map.yaml", **changes)).cells[::-1].tolist()


def test_a_png_has_the_original_values_and_the_highest_y_on_top(tmp_path):
    write_png(tmp_path / "map.png", grid())
    with Image.open(tmp_path / "map.png") as image:
        assert image.mode == "L"
        assert np.asarray(image).tolist() == [[0, 0, 255], [127, 255, 0]]


def test_a_map_server_pair_is_written_as_map_saver_does(tmp_path):
    yaml, pgm = write_map_server(tmp_path / "map.yaml", grid())
    assert pgm.read_bytes() == b"P5\n3 2\n255\n" + bytes([0, 0, 254, 205, 254, 0])
    assert yaml.read_text() == (
        "image: map.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.625, 2.5, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


@pytest.mark.parametrize("name", ["map", "the flat: 2nd floor #1", "12", "Küche", "no"])
@pytest.mark.parametrize("resolution, origin", [(0.05, (-1.625, 2.5, -1.25)), (1e-5, (1e-7, -123456.789, math.pi))])
def test_a_written_pair_reads_back_exactly(tmp_path, name, resolution, origin):
    random = np.random.default_rng(0)
    written = grid(random.integers(0, 3, (37, 53)).astype(np.uint8), resolution, origin)
    files = write_projection(tmp_path / name, written)
    found = read_occupancy(files[1])
    np.testing.assert_array_equal(found.cells, written.cells)
    assert (found.resolution, found.origin) == (resolution, origin)


def test_numbers_in_the_yaml_have_a_point_so_that_yaml_1_1_reads_numbers(tmp_path):
    yaml, _ = write_map_server(tmp_path / "map.yaml", grid(resolution=1e-5, origin=(1e-7, 3.0, 0.0)))
    assert "resolution: 0.00001\norigin: [0.0000001, 3.0, 0.0]\n" in yaml.read_text()


def test_thresholds_are_those_of_map_server(tmp_path):
    # p = (255 - v) / 255: 89 -> 0.651, 90 -> 0.647; 205 -> 0.19608, 206 -> 0.192.
    assert read_pixels(tmp_path, [[0, 89, 90, 205, 206, 254]]) == [[X, X, U, U, F, F]]


def test_a_negated_image_has_bright_obstacles(tmp_path):
    for yes in ("1", "true"):
        assert read_pixels(tmp_path, [[255, 166, 165, 50, 49, 0]], negate=yes) == [[X, X, U, U, F, F]]


def test_scale_keeps_only_what_is_certain_and_raw_reads_per_cent(tmp_path):
    assert read_pixels(tmp_path, [[0, 100, 254]], mode="scale") == [[X, U, F]]
    assert read_pixels(tmp_path, [[0, 19, 20, 65, 66, 100, 101, 255]], mode="raw") == [[F, F, U, U, X, X, U, U]]


def test_transparent_pixels_are_unknown_and_colours_are_averaged(tmp_path):
    pixels = [[[0, 0, 0, 255], [0, 0, 0, 254], [255, 255, 255, 0], [255, 255, 255, 255]]]
    assert read_pixels(tmp_path, pixels) == [[X, U, U, F]]
    # The mean of 255, 0, 0 is 85: p = 0.667. Luminance would be 76.
    assert read_pixels(tmp_path, [[[255, 0, 0], [255, 255, 0]]]) == [[X, U]]


def test_defaults_of_a_pair_and_an_image_elsewhere(tmp_path):
    (tmp_path / "images").mkdir()
    write_image(tmp_path / "images" / "a.pgm", [[0, 254]])
    for image in ("images/a.pgm", tmp_path / "images" / "a.pgm"):
        found = read_occupancy(write_yaml(tmp_path / "map.yaml", image, negate=None))
        assert found.cells.tolist() == [[X, F]]
        assert found.origin == (1.0, -2.0, 0.5)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"resolution": None}, ["no resolution"]),
        ({"resolution": "0"}, ["resolution: 0"]),
        ({"resolution": "-0.05"}, ["resolution: -0.05"]),
        ({"resolution": "five"}, ["resolution: 'five'"]),
        ({"resolution": ".nan"}, ["resolution: nan"]),
        ({"origin": "[0, 0]"}, ["origin", "x, y and yaw"]),
        ({"origin": "[0, 0, x]"}, ["origin: 'x'"]),
        ({"origin": None, "free_thresh": None}, ["no origin, free_thresh"]),
        ({"negate": "2"}, ["negate: 2"]),
        ({"mode": "ternary"}, ["mode: 'ternary'", "trinary, scale, raw"]),
        ({"occupied_thresh": "65"}, ["occupied_thresh 65"]),
        ({"free_thresh": "0.7"}, ["free_thresh 0.7"]),
        ({"image": "[1]"}, ["image: [1]"]),
        ({"image": "gone.pgm"}, ["gone.pgm does not exist"]),
        ({"image": None}, ["not the YAML file of a map_server pair"]),
    ],
)
def test_an_impossible_yaml_is_refused_with_the_field(tmp_path, changes, words):
    write_image(tmp_path / "map.png", [[0, 254]])
    path = write_yaml(tmp_path / "map.yaml", **changes)
    with pytest.raises(InputError) as error:
        read_occupancy(path)
    for word in (str(path), *words):
        assert word in str(error.value)


def test_a_yaml_that_is_none_and_an_image_that_is_none_are_refused(tmp_path):
    (tmp_path / "map.yaml").write_text("image: [")
    with pytest.raises(InputError, match=r"map\.yaml: not a YAML file"):
        read_occupancy(tmp_path / "map.yaml")
    (tmp_path / "map.png").write_bytes(b"P5\n3 2\n255\nabc")
    with pytest.raises(InputError, match=r"map\.png: the image cannot be read"):
        read_occupancy(write_yaml(tmp_path / "map.yaml"))
    Image.fromarray(np.zeros((2, 2), dtype=np.uint16)).save(tmp_path / "map.png")
    with pytest.raises(InputError, match=r"map\.png: pixels of the kind I;16.*8 bits"):
        read_occupancy(tmp_path / "map.yaml")


def test_a_yaml_of_endless_nesting_or_endless_digits_is_refused(tmp_path):
    path = tmp_path / "map.yaml"
    path.write_text("[" * 5000)
    with pytest.raises(InputError, match="not a YAML file"):
        read_occupancy(path)
    write_yaml(path, resolution="9" * 400)
    with pytest.raises(InputError, match="resolution: .* is no number"):
        read_occupancy(path)


def test_an_image_alone_is_refused_and_told_what_it_lacks(tmp_path):
    image = write_image(tmp_path / "map.png", [[0, 254]])
    with pytest.raises(InputError, match=r"how large its cells are.*there is no map\.yaml beside it"):
        read_occupancy(image)
    write_yaml(tmp_path / "map.yaml")
    with pytest.raises(InputError, match=r"give .*map\.yaml"):
        read_occupancy(image)


def test_what_is_no_map_of_the_ground_is_refused(tmp_path):
    (tmp_path / "map.txt").write_text("1 2 3\n")
    for path, words in ((tmp_path / "map.txt", "is no map of the ground"), (tmp_path / "gone.yaml", "no such file")):
        with pytest.raises(InputError, match=words):
            read_occupancy(path)
    with pytest.raises(InputError, match=r"--gt-topic /map: .*not a bag"):
        read_occupancy(tmp_path / "map.txt", ["/map"], "--gt-topic")


def test_files_of_a_projection_appear_together_or_not_at_all(tmp_path):
    (tmp_path / "map.pgm").write_text("mine")
    with pytest.raises(InputError, match=r"holds map\.pgm already"):
        write_projection(tmp_path / "map", grid())
    assert [path.name for path in tmp_path.iterdir()] == ["map.pgm"]
    assert (tmp_path / "map.pgm").read_text() == "mine"
    write_projection(tmp_path / "map", grid(), overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.pgm", "map.png", "map.yaml"]
    with pytest.raises(InputError, match=r"map\.png: ends like one"):
        write_projection(tmp_path / "map.png", grid(), overwrite=True)


# Bags


def grid_message(kind, values, width, *, resolution=0.05, xyz=(1.0, -2.0, 0.0), xyzw=(0, 0, 0, 1), stamp=10**9):
    data = np.asarray(values, dtype=np.int8)
    origin = bags.pose(kind, xyz, xyzw)
    time = bags.message(kind, "builtin_interfaces/Time", 0, 0)
    info = bags.message(kind, "nav_msgs/MapMetaData", time, resolution, width, len(data) // width, origin)
    return bags.message(kind, "nav_msgs/OccupancyGrid", bags.header(kind, stamp), info, data)


def write_grids(folder, kind, *messages, topic="/map", more=()):
    entries = [(topic, 10**9 * (i + 1), message) for i, message in enumerate(messages)]
    return bags.write_bag(bags.bag_path(folder, kind), kind, [*entries, *more])


@pytest.mark.parametrize("kind", bags.BAG_KINDS)
def test_the_last_grid_of_a_bag_is_read_with_its_origin(tmp_path, kind):
    older = grid_message(kind, [0] * 4, 2)
    values = [-1, 0, 19, 20, 64, 65, 100, 50]
    yaw = -2.1
    newer = grid_message(kind, values, 4, xyzw=(0, 0, math.sin(yaw / 2), math.cos(yaw / 2)))
    found = read_occupancy(write_grids(tmp_path, kind, older, newer))
    assert found.cells.tolist() == [[U, F, F, U], [U, X, X, U]]
    assert found.resolution == 0.05
    assert found.origin == pytest.approx((1.0, -2.0, yaw), abs=1e-12)
    assert found.frame_id == "map"
    assert any("the last of 2 grids" in note for note in found.notes)


def test_of_several_topics_one_must_be_named(tmp_path):
    kind = "ros1"
    other = [("/local", 5 * 10**9, grid_message(kind, [100], 1))]
    path = write_grids(tmp_path, kind, grid_message(kind, [0], 1), more=other)
    with pytest.raises(InputError, match=r"2 topics with maps of the ground.*--gt-topic NAME.*/local.*/map"):
        read_occupancy(path, (), "--gt-topic")
    assert read_occupancy(path, ["local"]).cells.tolist() == [[X]]
    with pytest.raises(InputError, match="no topic /nowhere"):
        read_occupancy(path, ["/nowhere"])


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"resolution": 0.0}, "a size of 0 m"),
        ({"xyzw": (0.5, 0.0, 0.0, math.sqrt(0.75))}, "tilted"),
        ({"xyzw": (0, 0, 0, 0.5)}, "norm 0.5"),
        ({"xyz": (math.nan, 0, 0)}, "its origin lies at nan"),
        ({"values": [0, 101, 0, -2]}, "2 cells hold values outside -1..100, the first 101"),
    ],
)
def test_impossible_grids_are_refused(tmp_path, changes, words):
    path = write_grids(tmp_path, "ros1", grid_message("ros1", changes.pop("values", [0] * 4), 2, **changes))
    with pytest.raises(InputError, match=words) as error:
        read_occupancy(path)
    assert "topic /map" in str(error.value)


def test_a_grid_whose_size_belies_its_data_or_is_zero_is_refused(tmp_path):
    message = grid_message("ros1", [0] * 6, 3)
    for width, words in ((2, "6 values for 2 x 2 cells"), (0, "an empty grid of 0 x 2")):
        message.info.width = width
        with pytest.raises(InputError, match=words):
            grid_of(message, "a topic")


def test_a_bag_without_grids_is_refused_and_lists_its_topics(tmp_path):
    path = bags.write_bag(tmp_path / "a.bag", "ros1", [("/pose", 10**9, bags.pose_stamped("ros1", 10**9, (0, 0, 0)))])
    with pytest.raises(InputError, match=r"no topic with maps of the ground.*\/pose"):
        read_occupancy(path)
    assert not holds_occupancy(path)


def test_what_a_path_is_meant_as_is_told_without_reading_it(tmp_path):
    kind = "ros1"
    more = [("/pose", 10**9, bags.pose_stamped(kind, 10**9, (0, 0, 0)))]
    path = write_grids(tmp_path, kind, grid_message(kind, [0], 1), more=more)
    assert holds_occupancy(path) and holds_occupancy(path, ["/map"])
    assert not holds_occupancy(path, ["/pose"])
    assert holds_occupancy(Path("map.yaml")) and holds_occupancy(Path("map.PGM"))
    assert not holds_occupancy(Path("map.pcd"))


def test_grids_are_of_no_use_where_maps_and_poses_are_scored(tmp_path):
    path = write_grids(tmp_path, "ros1", grid_message("ros1", [0], 1))
    with open_contents(path) as contents:
        assert not contents.grids and len(contents.others) == 1
    with pytest.raises(InputError, match="nothing that can be scored"), open_contents(path, ["/map"]):
        pass


def test_the_real_grid_is_refused_for_what_it_lacks_and_its_cells_are_right():
    """The recorded message has 30 x 30 unknown cells but for a block of 10 x 10, no resolution and no orientation."""
    path = shared_data("bags_pointcloud") / "ros_numpy_test.bag"
    with pytest.raises(InputError, match=r"ros_numpy_test\.bag, topic /occupancygrid: its cells have a size of 0 m"):
        read_occupancy(path)
    with open_contents(path, with_grids=True) as contents:
        message = contents.bag.last_message(contents.grids[0])
    message.info.resolution = 0.1
    found = grid_of(message, "patched")
    assert found.counts == {"total": 900, "unknown": 800, "free": 0, "occupied": 100}
    assert (found.cells[10:20, 10:20] == Cell.OCCUPIED).all()
    assert found.resolution == 0.1
    assert any("orientation is not set" in note for note in found.notes)
