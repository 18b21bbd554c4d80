"""Protocols of maps: presets, TOML, overrides, explanation."""

from __future__ import annotations

import dataclasses

import pytest
from typer.testing import CliRunner

from maomaps_warp.cli.app import app
from maomaps_warp.errors import InputError
from maomaps_warp.map_protocol import MAP_PRESETS, MapProtocol
from maomaps_warp.model.camera import Camera
from maomaps_warp.protocol_files import load_map_protocol, to_toml, with_overrides
from maomaps_warp.report.explain import explain_map


@pytest.mark.parametrize("name", MAP_PRESETS)
def test_a_preset_survives_the_way_through_toml(name, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(to_toml(MAP_PRESETS[name]))
    assert load_map_protocol(str(path)) == MAP_PRESETS[name]


def test_a_file_changes_what_it_names_and_takes_its_own_name(tmp_path):
    path = tmp_path / "coarse.toml"
    path.write_text('base = "gt_map_creator"\nvoxel_size = 0.1\nceiling = "height"\nceiling_height = 2\n')
    expected = dataclasses.replace(
        MAP_PRESETS["gt_map_creator"], name="coarse", voxel_size=0.1, ceiling="height", ceiling_height=2.0
    )
    assert load_map_protocol(str(path)) == expected


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("align = 'none'", "no such field: align"),
        ('base = "paper"', "presets: maomaps, gt_map_creator"),
        ("voxel_size = 0", "voxel_size = 0: must be above 0"),
        ("voxel_size = nan", "voxel_size = nan"),
        ("color_gap = -0.1", "color_gap = -0.1: must be at least 0"),
        ("max_stamp_gap = -1", "max_stamp_gap"),
        ("pixel_stride = 0.5", "must be a whole number"),
        ('rotation = "none"', "one of full, yaw"),
        ('ceiling = "height"', "needs ceiling_height"),
        ("ceiling_height = inf", "ceiling_height = inf"),
        ('camera = "320x240"', "WIDTHxHEIGHT@DEGREES"),
        ("min_range = 11.0", "below max_range"),
        ("arithmetic = 64", "one of float32, float64"),
    ],
)
def test_a_bad_file_is_refused_with_its_name_and_the_fault(tmp_path, text, found):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"bad\.toml") as error:
        load_map_protocol(str(path))
    assert found in str(error.value)


def test_every_constant_has_a_meaning_and_a_source_and_is_explained():
    for protocol in MAP_PRESETS.values():
        text = explain_map(protocol)
        for field in dataclasses.fields(MapProtocol):
            if field.name != "name":
                assert field.metadata["meaning"] and field.metadata["source"], field.name
                assert f"  {field.name} = " in text


def test_the_original_ignores_the_recorded_camera_and_joins_equal_stamps_only():
    original = MAP_PRESETS["gt_map_creator"]
    assert Camera.from_text(original.camera) == Camera(320, 240, 160.0, 160.0, 160.0, 120.0)
    assert (original.match, original.stamp_gap, original.color_gap) == ("nearest", 0.0, 0.0)


def test_the_gap_limit_follows_the_matching():
    assert MAP_PRESETS["maomaps"].effective()["max_stamp_gap"] == 0.2
    nearest = with_overrides(MAP_PRESETS["maomaps"], {"match": "nearest"}, "test")
    assert nearest.effective()["max_stamp_gap"] == 0.01


@pytest.mark.parametrize(
    ("words", "first_line"),
    [
        (("gt_map_creator",), "Map protocol gt_map_creator"),
        (("maomaps", "--map"), "Map protocol maomaps"),
        (("maomaps",), "Protocol maomaps"),
    ],
)
def test_explain_tells_protocols_of_maps_from_those_of_scores(words, first_line):
    result = CliRunner().invoke(app, ["explain", *words])
    assert (result.exit_code, result.stdout.splitlines()[0]) == (0, first_line)


def test_explain_prints_a_map_protocol_as_a_file_to_edit(tmp_path):
    path = tmp_path / "gt_map_creator.toml"
    path.write_text(CliRunner().invoke(app, ["explain", "gt_map_creator", "--toml"]).stdout)
    assert load_map_protocol(str(path)) == MAP_PRESETS["gt_map_creator"]
