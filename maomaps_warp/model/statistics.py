"""Statistics of a set of errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

_PERCENTILES = np.array([0.50, 0.90, 0.95])


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
        in_order = np.sort(errors)
        # As np.percentile does, which loads all of numpy.ma first: linear between the two nearest ranks.
        ranks = _PERCENTILES * (len(errors) - 1)
        median, p90, p95 = np.interp(ranks, np.arange(len(errors)), in_order)
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
