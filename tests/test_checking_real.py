"""Real recordings: each is recognised, also when it is handed over in another form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from check_scenes import written
from shared_data import shared_data

from maomaps_warp.checking.depth_unit import prove_depth_unit
from maomaps_warp.checking.proof import prove
from maomaps_warp.checking.recording import up_axis
from maomaps_warp.checking.sampling import sample_frames
from maomaps_warp.io.sources import SourceOptions, open_source
from maomaps_warp.model.camera import Camera

#: Name, camera where the set states none, share of the pixels that land that agree at least, the world's up (None: not
#: clear), and whether the depth unit is proved. Poses of these sets are off by up to 10 cm.
SETS = {
    "rgbd_nvblox_3dmatch": (None, 0.8, "+y", True),
    "rgbd_open3d_sample": (None, 0.9, "+y", True),
    "rgbd_slambook2_ch5": (Camera(640, 480, 518.0, 519.0, 325.5, 253.5), 0.75, "-y", True),
    "rgbd_tum_fr1_rpy_a": (None, 0.75, None, None),
}


def _opened(name):
    source = open_source(shared_data(name), SourceOptions(camera=SETS[name][0]), "one")
    return sample_frames(source.frames), source.trajectory


@pytest.mark.parametrize("name", SETS)
def test_a_real_recording_is_recognised_as_optical(name):
    _, agreeing, up, unit_fits = SETS[name]
    sample, poses = _opened(name)
    proof = prove(sample, poses)
    assert proof.is_clear, proof.reason
    assert proof.best.name == "optical"
    assert proof.candidates[0].agreement_of_landed > agreeing
    unit = prove_depth_unit(sample, poses, proof)
    assert unit.fits is unit_fits
    found = up_axis(poses.T_world_camera)
    assert (found.axis if found.is_clear else None) == up


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize(("axes", "inverse"), [("optical", True), ("body", False)])
def test_a_real_recording_is_recognised_in_another_form(name, axes, inverse):
    sample, poses = _opened(name)
    proof = prove(sample, replace(poses, T_world_camera=written(poses.T_world_camera, axes, inverse=inverse)))
    assert proof.is_clear, proof.reason
    assert proof.best.name == axes + "-inverse" * inverse


@pytest.mark.parametrize("name", ["rgbd_nvblox_3dmatch", "rgbd_open3d_sample", "rgbd_slambook2_ch5"])
def test_a_real_camera_tilted_in_its_body_is_not_taken_for_a_plain_one(name):
    sample, poses = _opened(name)
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    tilted = poses.T_world_camera.copy()
    tilted[:, :3, :3] = tilted[:, :3, :3] @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    assert not prove(sample, replace(poses, T_world_camera=written(tilted, "body"))).is_clear


def test_millimetres_taken_for_metres_are_found_in_a_real_recording():
    sample, poses = _opened("rgbd_slambook2_ch5")
    wrong = replace(sample, depth=sample.depth * np.float32(1000.0))
    unit = prove_depth_unit(wrong, poses, prove(wrong, poses))
    assert unit.fits is False
    assert unit.factor == 0.001
