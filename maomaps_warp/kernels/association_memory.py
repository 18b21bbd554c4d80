"""Memory of a launch of association in packets: what lies where, and how much of it there is.

Three kinds of blocks (see `lane_memory`), each of rows of numbers, one after the other: slots of elements, lines of
rays, and a list of poses.
"""

import warp as wp

from maomaps_warp.kernels.association_types import Pairs
from maomaps_warp.kernels.lanes import LANES

# Rows of the slots (`association_slots`). Places of the estimate's map are metres, relative to the grid's origin.
SLOT_X = wp.constant(0)  # x, y, z of the element
SLOT_BEST = wp.constant(3)  # squared distance below which a pose is wanted: inf for any, -1 for none
SLOT_POSE = wp.constant(4)  # the best pose so far, or NO_POSE
SLOT_CELL = wp.constant(5)  # x, y, z: field cell of the first predicted voxel that it sees
SLOT_WAY = wp.constant(8)  # x, y, z: the ray as its ground-truth pose casts it
SLOT_TRAIL = wp.constant(11)  # x, y, z: where the last ray was stopped, field coordinates
SLOT_STATUS = wp.constant(14)
SLOT_ELEMENT = wp.constant(15)  # where its answer goes
SLOT_ROWS = wp.constant(16)

#: Rays of a line (`ray_line`) that are cast at once.
LINE_FULL = wp.constant(2 * LANES)
#: Rays that a line has room for: one less than are cast, and those of one look.
LINE_ROOM = wp.constant(3 * LANES)
# Its rows: the ray; what its answer is for, six numbers; the answer, the cell of the first voxel as whole numbers.
LINE_ORIGIN = wp.constant(0)
LINE_DIRECTION = wp.constant(3 * LINE_ROOM)
LINE_OWNER = wp.constant(6 * LINE_ROOM)
LINE_CELL = wp.constant(12 * LINE_ROOM)
LINE_SIZE = 15 * LINE_ROOM

# What the answer to a ray of the estimate is for.
OWNER_SLOT = LINE_OWNER
OWNER_POSE = wp.constant(LINE_OWNER + LINE_ROOM)
OWNER_SQUARE = wp.constant(LINE_OWNER + 2 * LINE_ROOM)  # squared distance, square metres
OWNER_WAY = wp.constant(LINE_OWNER + 3 * LINE_ROOM)  # x, y, z: the ray as the ground-truth pose casts it

# Rows of the list (`association_culling`). The poses that may see the brick, in the order in which they are tried ...
LIST_POSE = wp.constant(0)
LIST_BOUND = wp.constant(1)  # ... and square metres: neither this pose nor a later one is nearer to an element.
CULLED_POSE = wp.constant(2)  # In order of time ...
CULLED_BOUND = wp.constant(3)  # ... and how near each is at least.
LIST_ROWS = wp.constant(4)
#: Squared distances are sorted by the highest bits of their float32: sixteen bins from 2^-8 to 2^-7 square metres,
#: sixteen to 2^-6, and so on up to 2^8 (16 m); the first and the last hold all that are nearer or further away.
BINS = wp.constant(256)


@wp.struct
class PoseLists:
    """Memory of one launch (see `lane_memory`) in which the poses of one brick after the other are listed: LIST_ROWS
    rows of `room` numbers, and BINS more."""

    address: wp.uint64
    room: wp.int32  # sixteen more than poses, for the lanes of the last


@wp.struct
class Workspace:
    """Memory of one launch, for one brick after the other."""

    lists: PoseLists
    room: wp.int32  # slots, a multiple of 16
    slots: wp.uint64  # address of a block of SLOT_ROWS x room numbers
    line: wp.uint64  # of LINE_SIZE numbers: rays of the estimate ...
    gt_line: wp.uint64  # ... and transferred ones
    memory: wp.array(dtype=wp.int32)  # which holds these blocks


def create_workspace(poses: int, elements: int) -> Workspace:
    """Memory for one launch over bricks of up to so many elements, on the CPU."""
    space = Workspace()
    space.room = -(-elements // 16) * 16
    space.lists.room = -(-poses // 16) * 16 + 16
    rows, line = SLOT_ROWS * space.room, int(LINE_SIZE)
    lists = LIST_ROWS * space.lists.room + BINS
    # Idle lanes compute with what is there, so zeros.
    space.memory = wp.zeros(rows + 2 * line + lists, dtype=wp.int32, device="cpu")
    space.slots = space.memory.ptr
    space.line = space.slots + 4 * rows
    space.gt_line = space.line + 4 * line
    space.lists.address = space.gt_line + 4 * line
    return space


def create_pairs(room: int) -> Pairs:
    """Memory for so many correspondences, on the CPU; a launch after the other may use it."""
    pairs = Pairs()
    pairs.used = wp.zeros(1, dtype=wp.int32, device="cpu")
    pairs.element, pairs.pose, pairs.est_voxel, pairs.gt_voxel = (
        wp.empty(room, dtype=wp.int32, device="cpu") for _ in range(4)
    )
    return pairs
