"""Numbers of sixteen rays, elements or poses side by side: what fills the widest registers at hand."""

import warp as wp

LANES = wp.constant(16)
lanes_f = wp.types.vector(length=16, dtype=wp.float32)
lanes_i = wp.types.vector(length=16, dtype=wp.int32)
