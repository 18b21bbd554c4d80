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
        in_order = np.sort(errors)
        # Not np.dot: the order of its sum depends on the number of threads.
        sse = float(np.square(errors).sum())
        return cls(
            count=len(errors),
            rmse=float(np.sqrt(sse / len(errors))),
            mean=float(errors.mean()),
            median=_percentile(in_order, 50.0),
            std=float(errors.std()),
            min=float(in_order[0]),
            max=float(in_order[-1]),
            p90=_percentile(in_order, 90.0),
            p95=_percentile(in_order, 95.0),
            sse=sse,
        )

    def as_dict(self) -> dict[str, float]:
        """The fields by name, for JSON."""
        return asdict(self)


def median(values: NDArray[np.float64]) -> float:
    """`np.median` of values, (N,) float64, finite, N >= 1, to the last bit.

    Here and below not NumPy's: they load numpy.ma, which nothing else does where maps are scored without stamps; and
    its median takes six times as long.
    """
    half = len(values) // 2
    halves = np.partition(values, half)
    upper = float(halves[half])
    return upper if len(values) % 2 else (float(halves[:half].max()) + upper) / 2.0


def _percentile(in_order: NDArray[np.float64], percent: float) -> float:
    """`np.percentile` of sorted values, (N,) float64, N >= 1, to the last bit: linear between two ranks."""
    place = percent / 100.0 * (len(in_order) - 1)
    below = int(place)
    low, high = float(in_order[below]), float(in_order[min(below + 1, len(in_order) - 1)])
    share, step = place - below, high - low
    return low + step * share if share < 0.5 else high - step * (1.0 - share)
