"""The documented way to plug in Habitat does what it says, with a stand-in for habitat-sim."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from maomaps_warp.io.sources import SourceOptions, open_source
from maomaps_warp.model.pose_convention import y_up_opengl_poses

PAGE = (Path(__file__).parents[1] / "docs" / "simulation.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"<!-- run by tests/test_docs_simulation.py -->\n```python\n(.*?)```", PAGE, re.DOTALL)

#: habitat-sim as far as the example goes: agents with a y-up OpenGL pose, rays in the file's own coordinates.
STAND_IN = """
from types import SimpleNamespace
import numpy as np
import trimesh

SensorType = SimpleNamespace(COLOR=1, DEPTH=2)
CameraSensorSpec = SimulatorConfiguration = AgentState = lambda: SimpleNamespace()
agent = SimpleNamespace(AgentConfiguration=lambda sensor_specifications: sensor_specifications)


def Configuration(backend, agents):
    return SimpleNamespace(backend=backend, agents=agents)


class Simulator:
    def __init__(self, configuration):
        self.mesh = trimesh.load(configuration.backend.scene_id, force="mesh")
        ((color, depth),) = configuration.agents
        assert depth.sensor_type == SensorType.DEPTH and depth.position == [0.0, 0.0, 0.0]
        self.height, self.width = depth.resolution
        self.focal = 0.5 * self.width / np.tan(np.radians(0.5 * depth.hfov))

    def get_agent(self, number):
        return SimpleNamespace(set_state=lambda state: setattr(self, "state", state))

    def get_sensor_observations(self):
        rows, columns = np.indices((self.height, self.width)).reshape(2, -1)
        x = (columns + 0.5 - 0.5 * self.width) / self.focal
        y = (0.5 * self.height - rows - 0.5) / self.focal
        rays = np.stack([x, y, -np.ones_like(x)], axis=1) @ self.state.rotation.T
        # Moeller and Trumbore 1997: where each ray (rows) meets each triangle (columns).
        a, b, c = np.moveaxis(self.mesh.triangles, 1, 0)
        p = np.cross(rays[:, None], c - a)
        scale = (p * (b - a)).sum(axis=2)
        scale = np.where(np.abs(scale) < 1e-12, np.nan, scale)
        s = self.state.position - a
        q = np.cross(s, b - a)
        u, v, t = (p * s).sum(axis=2) / scale, rays @ q.T / scale, ((c - a) * q).sum(axis=1) / scale
        with np.errstate(invalid="ignore"):
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
        depth = t.min(axis=1)  # rays have length 1 along the optical axis
        shape = (self.height, self.width)
        return {"depth": depth.reshape(shape), "rgb": np.full((*shape, 4), 77, np.uint8)}
"""


def room(path: Path) -> None:
    """5 m x 4 m x 2.5 m, y up, with a box in a corner so that no two views are alike."""
    walls = trimesh.creation.box((5.0, 2.5, 4.0))
    walls.invert()
    box = trimesh.creation.box((0.8, 0.9, 0.6))
    box.apply_translation((1.8, -0.8, 1.4))
    trimesh.util.concatenate([walls, box]).export(path)


@pytest.mark.slow
def test_the_habitat_example_records_what_our_own_renderer_sees(tmp_path: Path) -> None:
    room(tmp_path / "house.glb")
    (tmp_path / "habitat_sim.py").write_text(STAND_IN)
    # A rotation that stays a matrix stands in for numpy-quaternion.
    (tmp_path / "quaternion.py").write_text("def from_rotation_matrix(R):\n    return R\n")
    small = EXAMPLE.replace("320, 240", "40, 30").replace("duration=5.0", "duration=2.0")
    (tmp_path / "example.py").write_text(small)
    done = subprocess.run([sys.executable, "example.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("21 frames\n")

    from typer.testing import CliRunner

    from maomaps_warp.cli.app import app

    ours = ["record", str(tmp_path / "house.glb"), "-o", str(tmp_path / "ours.bag"), "--camera", "40x30@90"]
    result = CliRunner().invoke(app, [*ours, "--duration", "2", "--seed", "1", "--back-faces", "seen"])
    assert result.exit_code == 0, result.output
    sides = [
        open_source(tmp_path / name, SourceOptions(pose_frame="maomaps-c"), "gt") for name in ("run.bag", "ours.bag")
    ]
    for a, b in zip(*(side.frames.read(True) for side in sides if side.frames), strict=True):
        # Rays along an edge may take either side of it.
        assert (np.abs(a.depth - b.depth) < 1e-4).mean() > 0.995
        assert a.colors is not None and (a.colors == 77).all()


def test_poses_for_y_up_worlds_are_right_by_hand() -> None:
    # In our world: at (1, 2, 3), looking along +x; its image's right is -y, its down is -z.
    T = np.eye(4)
    T[:3, :3] = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]).T
    T[:3, 3] = (1.0, 2.0, 3.0)
    there = y_up_opengl_poses(T)
    # With y up: z is -y of ours, so it stands at (1, 3, -2); right is +z, up is +y, backward is -x.
    np.testing.assert_allclose(there[:3, 3], [1.0, 3.0, -2.0])
    np.testing.assert_allclose(there[:3, :3].T, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
