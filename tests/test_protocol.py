"""Protocols: presets, TOML, overrides, explanation."""

from __future__ import annotations

import dataclasses

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.protocol import PRESETS, Protocol
from maomaps_warp.protocol_files import load_protocol, to_toml, with_overrides
from maomaps_warp.report.explain import explain


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_survives_the_way_through_toml(name, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(to_toml(PRESETS[name]))
    assert load_protocol(str(path)) == PRESETS[name]


def test_a_file_changes_what_it_names_and_takes_its_own_name(tmp_path):
    path = tmp_path / "coarse.toml"
    path.write_text('base = "paper"\nvoxel_size = 0.1\nthresholds = [0.1, 1]\nmax_stamp_gap = 1\n')
    protocol = load_protocol(str(path))
    assert protocol == dataclasses.replace(
        PRESETS["paper"], name="coarse", voxel_size=0.1, thresholds=(0.1, 1.0), max_stamp_gap=1.0
    )


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("voxel = 0.1", "no such field: voxel"),
        ('base = "maomap"', "base = 'maomap'"),
        ("voxel_size = 0", "voxel_size = 0: must be above 0"),
        ("voxel_size = true", "voxel_size = True: must be a number"),
        ('voxel_size = "5 cm"', "must be a number"),
        ("pixel_stride = 1.5", "must be a whole number"),
        ("two_sided_view = 1", "must be true or false"),
        ('align = "icp"', "align = 'icp'"),
        ("align = 3", "align = 3"),
        ("voxel_size = nan", "voxel_size = nan: must be a number"),
        ("prune_leaves = true", "floored"),
        ("thresholds = []", "thresholds"),
        ("min_range = 20.0", "min_range"),
        ("voxel_size = = 2", "not a TOML file"),
    ],
)
def test_a_bad_file_is_refused_with_its_name_and_the_fault(tmp_path, text, found):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"bad\.toml") as error:
        load_protocol(str(path))
    assert found in str(error.value)


def test_an_unknown_name_lists_the_presets():
    with pytest.raises(InputError, match="maomaps, paper, slam_comparison"):
        load_protocol("mapmaos")


def test_every_constant_has_a_meaning_and_a_source():
    for field in dataclasses.fields(Protocol):
        if field.name != "name":
            assert field.metadata["meaning"], field.name
            assert field.metadata["source"], field.name


@pytest.mark.parametrize("name", PRESETS)
def test_the_explanation_names_every_constant(name):
    text = explain(PRESETS[name])
    for field in dataclasses.fields(Protocol):
        assert f"  {field.name} = " in text or field.name == "name"


def test_the_gap_limit_follows_the_matching():
    assert PRESETS["maomaps"].effective()["max_stamp_gap"] == 0.2
    nearest = with_overrides(PRESETS["maomaps"], {"match": "nearest"}, "--match")
    assert nearest.effective()["max_stamp_gap"] == 0.01


def test_an_infinite_limit_is_null_in_the_result():
    assert PRESETS["maomaps"].effective()["view_range"] is None
