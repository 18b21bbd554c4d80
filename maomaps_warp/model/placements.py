"""Where a method of merging puts a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Placement:
    """What a method of merging says of one source.

    Attributes:
        T_merged_source: (4, 4) float64, metres: source coordinates to the merged map's; None: not merged.
        confidence: 0 to 1, as its method defines it; None where it has none.
        reason: why it was not merged; empty if it was.
    """

    T_merged_source: NDArray[np.float64] | None
    confidence: float | None = None
    reason: str = ""
