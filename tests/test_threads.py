"""Work side by side: the same on any number of threads."""

from __future__ import annotations

import threading

import pytest

from maomaps_warp.errors import InputError
from maomaps_warp.threads import side_by_side


@pytest.mark.parametrize("threads", ["1", "2", "5"])
def test_results_come_in_the_order_of_the_works(threads, monkeypatch):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    assert side_by_side(lambda: 1, lambda: "two", lambda: None) == (1, "two", None)
    assert side_by_side() == ()


def test_works_run_at_the_same_time(monkeypatch):
    monkeypatch.setenv("MAOMAPS_THREADS", "2")
    meeting = threading.Barrier(2, timeout=30.0)
    assert sorted(side_by_side(meeting.wait, meeting.wait)) == [0, 1]


@pytest.mark.parametrize("threads", ["1", "2"])
def test_of_several_errors_the_first_works_is_raised_whichever_came_first(threads, monkeypatch):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    est_failed = threading.Event()

    def gt():
        if threads == "2":
            assert est_failed.wait(timeout=30.0)
        raise InputError("gt", "is missing")

    def est():
        est_failed.set()
        raise InputError("est", "is missing")

    with pytest.raises(InputError, match="gt"):
        side_by_side(gt, est)


def test_on_a_gpu_works_run_one_after_the_other():
    names = side_by_side(*[lambda: threading.current_thread().name] * 3, device="cuda:0")
    assert set(names) == {threading.current_thread().name}
