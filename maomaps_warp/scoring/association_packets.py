"""Association with packets of elements, on a CPU: chunks of elements side by side on all cores."""

from __future__ import annotations

import threading
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from maomaps_warp.mapping.distance_field import VoxelField
from maomaps_warp.scoring.association_search import Found, pose_pairs, view_of
from maomaps_warp.scoring.element_bricks import ElementBricks, sort_into_bricks
from maomaps_warp.threads import thread_count

if TYPE_CHECKING:
    from maomaps_warp.scoring.association import ViewRules

#: Elements of the first chunk, which loads the kernels while the other cores wait.
_FIRST_CHUNK = 64
#: Chunks for each thread: some cost more than others, and a thread that ends early takes the next.
_CHUNKS_PER_THREAD = 7
#: Elements of a chunk: enough that bricks are whole, few enough that progress is told.
_CHUNK_POINTS = (1 << 11, 1 << 15)
#: Most correspondences for which a launch has room; 16 bytes each, in each thread, touched only where some are found.
_MOST_PAIRS = 1 << 24


class PacketSearch:
    """The arrays of one association in packets, and its launches chunk by chunk."""

    def __init__(
        self,
        elements: NDArray[np.float64],
        est: VoxelField,
        gt: VoxelField,
        T_est: NDArray[np.float64],
        T_gt: NDArray[np.float64],
        rules: ViewRules,
    ) -> None:
        import warp as wp

        from maomaps_warp.kernels import association_types as kinds
        from maomaps_warp.kernels.lanes import lanes_f

        self.rules, self.elements, self.grid, self.poses = rules, elements, est.voxels.grid, len(T_est)
        self.sight = kinds.Sight()
        self.sight.poses = pose_pairs(self.grid.origin, T_est, T_gt, "cpu")
        self.sight.blocks = wp.array(_pose_blocks(self.grid.origin, T_est, rules), dtype=lanes_f, device="cpu")
        self.sight.view = view_of(rules)
        self.sight.est, self.sight.gt = est.field, gt.field
        self.sight.tolerance = rules.occlusion_tolerance
        for side, field in (("est", est.field), ("gt", gt.field)):
            origins = _ray_origins(field, getattr(self.sight.poses, f"{side}_position").numpy())
            setattr(self.sight, f"{side}_origin", wp.array(origins, dtype=wp.vec3, device="cpu"))
        choices = {"nearest": kinds.NEAREST, "first": kinds.FIRST, "last": kinds.LAST, "all": kinds.EVERY}
        self.choice = int(choices[rules.pose_choice])
        self._own = threading.local()

    def chunks(self) -> list[slice]:
        """Elements of one launch each: neighbours, as maps list their voxels in order."""
        count = len(self.elements)
        size = int(np.clip(count // (_CHUNKS_PER_THREAD * thread_count()), *_CHUNK_POINTS))
        edges = [0, *range(min(_FIRST_CHUNK, count), count, size), count]
        return [slice(a, b) for a, b in pairwise(edges) if a < b]

    def run(self, rows: slice) -> tuple[NDArray[np.int32], Found]:
        """Best status (n,) of the elements in `rows`, and their correspondences."""
        import warp as wp

        from maomaps_warp.kernels import association_packets as kernels

        count = rows.stop - rows.start
        most = count * (self.poses if self.rules.pose_choice == "all" else 1)
        if most > _MOST_PAIRS and count > 1:
            middle = (rows.start + rows.stop) // 2
            halves = [self.run(slice(rows.start, middle)), self.run(slice(middle, rows.stop))]
            status = np.concatenate([half[0] for half in halves])
            return status, Found(*(np.concatenate(columns) for columns in zip(*(h[1] for h in halves), strict=True)))
        columns = tuple((self.elements[rows, a] - self.grid.origin[a]).astype(np.float32) for a in range(3))
        bricks = _kernel_bricks(sort_into_bricks(columns, self.grid.voxel_size))
        pairs = self._room_for(most)
        statuses, counts = kernels.associate_packets(bricks, self.sight, self.choice, count, pairs)
        ends = np.cumsum(counts.numpy(), dtype=np.int32)
        first = wp.array(ends - counts.numpy(), dtype=wp.int32, device="cpu")
        outs = kernels.in_order(pairs, rows.start, first)
        return statuses.numpy(), Found(*(out.numpy() for out in outs))

    def _room_for(self, pairs: int) -> Any:
        """Memory of this thread, made once: fresh memory costs more to touch than to fill."""
        from maomaps_warp.kernels.association_memory import create_pairs

        if getattr(self._own, "room", -1) < pairs:
            self._own.pairs = create_pairs(pairs)
            self._own.room = pairs
        return self._own.pairs


def _kernel_bricks(bricks: ElementBricks) -> Any:
    import warp as wp

    from maomaps_warp.kernels.association_types import Bricks

    on_device = Bricks()
    on_device.first = wp.array(bricks.first, dtype=wp.int32, device="cpu", copy=False)
    on_device.x, on_device.y, on_device.z = (
        wp.array(c, dtype=wp.float32, device="cpu", copy=False) for c in bricks.columns
    )
    on_device.element = wp.array(bricks.order.astype(np.int32), dtype=wp.int32, device="cpu")
    return on_device


def _ray_origins(field: Any, positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Positions (P, 3), metres relative to the grid's origin, in field coordinates: the kernels' `ray_origin`."""
    shift = np.array(field.origin_shift, dtype=np.float64)
    return (positions.astype(np.float64) * float(field.origin_scale) + shift).astype(np.float32)


def _pose_blocks(
    origin: NDArray[np.float64], T_world_camera: NDArray[np.float64], rules: ViewRules
) -> NDArray[np.float32]:
    """Poses for culling, (ceil(P / 16), 18, 16) float32: position, normals of the view's borders, optical axis."""
    x_min, x_max, y_min, y_max = rules.camera.tangent_bounds
    borders = np.array([[1, 0, -x_min], [-1, 0, x_max], [0, 1, -y_min], [0, -1, y_max], [0, 0, 1]])
    poses = len(T_world_camera)
    rows = np.zeros((-(-poses // 16) * 16, 6, 3), dtype=np.float32)
    rows[:poses, 0] = T_world_camera[:, :3, 3] - origin
    rows[:poses, 1:] = np.einsum("pij,nj->pni", T_world_camera[:, :3, :3], borders)
    return np.ascontiguousarray(rows.reshape(-1, 16, 18).transpose(0, 2, 1))
