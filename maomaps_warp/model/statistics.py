"""Statistics of a set of errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Statistics:
    """The usual statistics of non-negative errors, in the errors' unit; std with ddof 0, sse in unit squared."""

    count: int
    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    p90: float
    p95: float
    sse: float

    @classmethod
    def of(cls, errors: NDArray[np.float64]) -> Statistics | None:
        """Statistics of `errors`, (N,) float64, finite; None if there are none: no data, no number."""
        if not len(errors):
            return None
        in_order = np.sort(errors)  # in which NumPy finds percentiles at once; both take less time than finding alone
        median, p90, p95 = np.percentile(in_order, [50, 90, 95])
        # Not np.dot: the order of its sum depends on the number of threads.
        sse = float(np.square(errors).sum())
        return cls(
            count=len(errors),
            rmse=float(np.sqrt(sse / len(errors))),
            mean=float(errors.mean()),
            median=float(median),
            std=float(errors.std()),
            min=float(in_order[0]),
            max=float(in_order[-1]),
            p90=float(p90),
            p95=float(p95),
            sse=sse,
        )

    def as_dict(self) -> dict[str, float]:
        """The fields by name, for JSON."""
        return asdict(self)
