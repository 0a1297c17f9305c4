"""Wall-clock and processor time."""

import resource
import time


class Timer:
    """Wall-clock and processor time of this process and of its children."""

    def __enter__(self):
        self.wall, self.processor = time.perf_counter(), self.used()
        return self

    def __exit__(self, *_):
        self.wall, self.processor = time.perf_counter() - self.wall, self.used() - self.processor

    @staticmethod
    def used():
        all_of = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        return sum(u.ru_utime + u.ru_stime for u in all_of)
