"""Tracks of points: evened out, and smoothed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def resampled(track: NDArray[np.float64], step: float, *, closed: bool = False) -> NDArray[np.float64]:
    """Points of a polygon, (K, D) metres, about `step` apart along it; the last is the first's neighbour if closed."""
    corners = np.vstack([track, track[:1]]) if closed else track
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    count = max(1, round(along[-1] / step))
    samples = np.linspace(0.0, along[-1], count if closed else count + 1, endpoint=not closed)
    return np.stack([np.interp(samples, along, column) for column in corners.T], axis=1)


def smoothed(track: NDArray[np.float64], sigma: float, *, closed: bool = False) -> NDArray[np.float64]:
    """Columns of a track, (N, D), under a Gaussian of standard deviation `sigma` points.

    A closed track goes on at its start. The ends of an open one stay where they are, and a straight one stays straight:
    it is mirrored in its ends.
    """
    from scipy import ndimage

    if closed:
        return np.asarray(ndimage.gaussian_filter1d(track, sigma, axis=0, mode="wrap"))
    reach = min(int(4.0 * sigma) + 1, len(track) - 1)
    before = 2.0 * track[:1] - track[reach:0:-1]
    behind = 2.0 * track[-1:] - track[-2 : -2 - reach : -1]
    padded = np.concatenate([before, track, behind[:reach]])
    return np.asarray(ndimage.gaussian_filter1d(padded, sigma, axis=0, mode="nearest")[reach : reach + len(track)])
