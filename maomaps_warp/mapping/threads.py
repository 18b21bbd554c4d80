"""How many threads the stages use on a CPU: `maomaps_warp.threads`, which readers use too."""

from maomaps_warp.threads import THREADS_VARIABLE, thread_count

__all__ = ["THREADS_VARIABLE", "thread_count"]
