"""Work on what comes next, in threads, while the caller works on what came before."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from maomaps_warp.threads import thread_count

Job = TypeVar("Job")
Result = TypeVar("Result")

#: Results beyond the threads' own that may lie ready: enough to bridge a slow step, few enough to keep memory flat.
SPARE_RESULTS = 2


def ahead(work: Callable[[Job], Result], jobs: Iterator[Job]) -> Generator[Result]:
    """The results of `work` on each job, in the order of the jobs, computed ahead in threads.

    Jobs are taken in the caller's thread: one at first, for many callers want no more, then at most SPARE_RESULTS and
    one for each thread ahead of it. An error comes where it would come without threads: behind the results of all jobs
    before. The threads end with the generator.

    Args:
        work: must be free of side effects: it may be done for jobs whose results nobody asks for.
        jobs: what to do.

    Yields:
        One result for each job.
    """
    pending: deque[Future[Result]] = deque()
    failure: BaseException | None = None
    is_empty = False
    threads, allowed = thread_count(), 1
    pool = ThreadPoolExecutor(threads)
    try:
        while True:
            while not is_empty and len(pending) < allowed:
                try:
                    pending.append(pool.submit(work, next(jobs)))
                except StopIteration:
                    is_empty = True
                except Exception as error:  # of any kind, for it is only put off
                    failure, is_empty = error, True
            if not pending:
                break
            yield pending.popleft().result()
            allowed = threads + SPARE_RESULTS
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    if failure is not None:
        raise failure
