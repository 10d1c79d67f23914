"""Work that threads share."""

from __future__ import annotations

import threading

import pytest

from needlehoop.envs.threads import Threads


@pytest.mark.parametrize("count", [1, 2, 5])
def test_what_is_made_comes_in_the_order_of_the_items(count):
    threads = Threads(count)
    for items in (0, 1, 3, 50):
        found = threads.map(lambda a, b: (a, b), range(items), range(items))
        assert found == [(i, i) for i in range(items)]


def test_threads_work_side_by_side():
    together = threading.Barrier(3, timeout=30)
    assert len(Threads(3).map(lambda _: together.wait(), range(3))) == 3


@pytest.mark.parametrize(
    ("count", "images", "sizes"),
    [(1, 80, [20] * 4), (2, 80, [20] * 4), (8, 80, [10] * 8), (64, 80, [5] * 16), (2, 13, [7, 6])],
)
def test_images_are_parted_for_the_threads_that_there_are(count, images, sizes):
    parts = Threads(count).parts(images)
    assert [part.stop - part.start for part in parts] == sizes
    assert [row for part in parts for row in range(images)[part]] == [*range(images)]


def test_work_aside_may_share_out_parts_of_its_own():
    threads = Threads(2)
    waits = threads.begin(lambda: threads.map(abs, [-1, -2]))
    assert threads.map(abs, range(-20, 0)) == list(range(20, 0, -1))
    assert waits() == [1, 2]
