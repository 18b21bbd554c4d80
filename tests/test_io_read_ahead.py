"""Work ahead of the caller: the same results, in order, and errors where they belong."""

from __future__ import annotations

import threading

import pytest

from maomaps_warp.io.read_ahead import SPARE_RESULTS, ahead

every_count = pytest.mark.parametrize("threads", ["1", "3"])


@every_count
def test_results_come_in_the_order_of_their_jobs(monkeypatch, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    assert list(ahead(lambda job: job * job, iter(range(100)))) == [job * job for job in range(100)]
    assert list(ahead(lambda job: job, iter(()))) == []


@every_count
def test_an_error_of_a_job_comes_behind_the_results_before_it(monkeypatch, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    results = []
    with pytest.raises(ZeroDivisionError):
        for result in ahead(lambda job: 1 / (5 - job), iter(range(9))):
            results.append(result)
    assert len(results) == 5


@every_count
def test_an_error_of_the_source_comes_behind_all_results_before_it(monkeypatch, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)

    def jobs():
        yield from range(5)
        raise ValueError("the source is damaged")

    results = []
    with pytest.raises(ValueError, match="damaged"):
        for result in ahead(lambda job: job, jobs()):
            results.append(result)
    assert results == [0, 1, 2, 3, 4]


@every_count
def test_only_a_few_jobs_are_taken_ahead_and_one_at_first(monkeypatch, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    taken = []

    def jobs():
        for job in range(1000):
            taken.append(job)
            yield job

    for number, _ in enumerate(ahead(lambda job: job, jobs())):
        assert len(taken) <= (1 if number == 0 else number + int(threads) + SPARE_RESULTS)


@every_count
def test_the_threads_end_with_a_generator_that_is_closed_early(monkeypatch, threads):
    monkeypatch.setenv("MAOMAPS_THREADS", threads)
    before = threading.active_count()
    results = ahead(lambda job: job, iter(range(1000)))
    assert [next(results), next(results)] == [0, 1]
    assert threading.active_count() > before
    results.close()
    assert threading.active_count() == before
