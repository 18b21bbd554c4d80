"""Where a robot fits into a scene: whether the pile of balls that stands for it touches a surface.

A robot of radius r that stands on the floor is a vertical stack of balls of radius r from the height of the steps it
can take to its top: walls of no thickness, table tops and lamps block it alike, whichever way their triangles lie.

Cost: a nearest-point query of wp.Mesh for each ball, which ends at the radius; and one ray down for the floor.
"""

import warp as wp

from maomaps_warp.kernels.checks import check_array
from maomaps_warp.kernels.modules import RENDER
from maomaps_warp.kernels.ranges import launch_ranges

#: Least places of a range of a launch.
_LEAST_PLACES = 256


@wp.struct
class RobotShape:
    """The robot and the floor it stands on; metres."""

    radius: wp.float32
    lowest: wp.float32  # height of the lowest ball's centre above the floor
    highest: wp.float32  # and of the highest one's
    balls: wp.int32  # >= 1
    step: wp.float32  # how far the floor may lie above or below its height
    floor_z: wp.float32
    needs_floor: wp.bool  # a place without a surface at the floor's height is not free


@wp.func
def fits(mesh: wp.uint64, robot: RobotShape, x: wp.float32, y: wp.float32) -> wp.bool:
    """Whether the robot can stand at (x, y)."""
    is_free = bool(True)
    if robot.needs_floor:
        above = wp.vec3(x, y, robot.floor_z + robot.step)
        is_free = wp.mesh_query_ray(mesh, above, wp.vec3(0.0, 0.0, -1.0), 2.0 * robot.step).result
    ball = int(0)
    while is_free and ball < robot.balls:
        share = wp.float32(ball) / wp.float32(wp.max(robot.balls - 1, 1))
        height = robot.lowest + share * (robot.highest - robot.lowest)
        center = wp.vec3(x, y, robot.floor_z + height)
        is_free = not wp.mesh_query_point_no_sign(mesh, center, robot.radius).result
        ball += 1
    return is_free


@wp.kernel(module=RENDER)
def _fits_kernel(
    # In:
    start: wp.int32,
    mesh: wp.uint64,
    robot: RobotShape,
    places: wp.array(dtype=wp.vec2),
    # Out:
    out_free: wp.array(dtype=wp.uint8),
):
    place = start + wp.tid()
    is_free = fits(mesh, robot, places[place][0], places[place][1])
    out_free[place] = wp.where(is_free, wp.uint8(1), wp.uint8(0))


def find_free_places(mesh: wp.Mesh, robot: RobotShape, places: wp.array, *, threads: int = 1) -> wp.array:
    """Where a robot can stand.

    Args:
        mesh: the scene, metres, z up.
        robot: its shape.
        places: (N,) vec2, x and y, metres.
        threads: on a CPU.

    Returns:
        (N,) uint8: 1 where it fits.
    """
    device = mesh.device
    check_array("places", places, wp.vec2, (None,), device)
    free = wp.empty(len(places), dtype=wp.uint8, device=device)
    launch_ranges(
        _fits_kernel,
        len(places),
        inputs=[mesh.id, robot, places],
        outputs=[free],
        device=device,
        threads=threads,
        grain=_LEAST_PLACES,
    )
    return free
