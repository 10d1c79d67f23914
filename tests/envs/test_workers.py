"""Work that threads share."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading

import pytest

from needlehoop.envs.workers import Workers


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_what_is_made_comes_in_the_order_of_the_items(threads):
    workers = Workers(threads)
    for count in (0, 1, 2, 3, 50):
        assert workers.map(lambda a, b: (a, b), range(count), range(count)) == [
            (i, i) for i in range(count)
        ]


def test_every_thread_works_and_the_caller_is_one_of_them():
    together = threading.Barrier(3, timeout=30)

    def work(_: int) -> int:
        together.wait()
        return threading.get_ident()

    found = Workers(3).map(work, range(3))
    assert len(set(found)) == 3
    assert threading.get_ident() in found


@pytest.mark.parametrize("threads", [1, 3])
def test_the_first_item_that_fails_is_raised_and_the_next_work_is_done(threads):
    workers = Workers(threads)
    with pytest.raises(ZeroDivisionError, match="division"):
        workers.map(lambda x: 1 // x if x < 3 else [][x], [1, 0, 2, 3, 4])
    assert workers.map(abs, [-1, 2, -3]) == [1, 2, 3]


@pytest.mark.parametrize(
    ("threads", "count", "sizes"),
    [(1, 80, [20] * 4), (2, 80, [20] * 4), (8, 80, [10] * 8), (64, 80, [5] * 16), (2, 13, [7, 6])],
)
def test_images_are_parted_for_the_threads_that_there_are(threads, count, sizes):
    parts = Workers(threads).parts(count)
    assert [part.stop - part.start for part in parts] == sizes
    assert [row for part in parts for row in range(count)[part]] == [*range(count)]


def test_work_aside_may_share_out_parts_of_its_own():
    workers = Workers(2)
    waits = workers.begin(lambda: workers.map(abs, [-1, -2]))
    assert workers.map(abs, range(-20, 0)) == list(range(20, 0, -1))
    assert waits() == [1, 2]


def test_threads_end_with_their_workers():
    before = set(threading.enumerate())
    workers = Workers(4)
    workers.map(abs, range(10))
    started = set(threading.enumerate()) - before
    assert len(started) == 3
    del workers
    gc.collect()
    assert not [thread for thread in started if thread.is_alive()]


def test_python_ends_after_what_a_thread_is_still_at():
    """As of freeing a batch, in which torch asks for the interpreter."""
    script = """
import time
from needlehoop.envs.workers import Workers, _Shared

def slow():
    time.sleep(1.0)
    print("done", flush=True)

workers = Workers(2)
workers._shares.put(_Shared(slow, [()]))
time.sleep(0.2)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")
