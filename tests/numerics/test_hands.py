"""Many hands: the same result in the same order, whoever does it."""

import threading
import time

import pytest

from piezoid.numerics.hands import ALONE, Hands


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_come_in_the_order_of_what_was_asked(count) -> None:
    hands = Hands(count=count)
    assert hands.each(lambda n: n * n, iter([3, 1, 2])) == [9, 1, 4]
    assert hands.each(str, []) == []
    assert hands.both(lambda: "one", lambda: 2) == ("one", 2)


def test_two_hands_work_at_the_same_time_and_one_does_not() -> None:
    together = threading.Barrier(2, timeout=10.0)
    Hands(count=2).each(lambda _: together.wait(), range(2))
    Hands(count=2).both(together.wait, together.wait)
    threads = ALONE.each(lambda _: threading.get_ident(), range(3))
    assert set(threads) == {threading.get_ident()}


def test_many_hands_speak_one_at_a_time() -> None:
    speaking, heard = threading.Lock(), []

    def told(text: str) -> None:
        assert speaking.acquire(blocking=False)
        time.sleep(0.002)
        heard.append(text)
        speaking.release()

    hands = Hands(told=told, count=4)
    hands.each(lambda n: hands.say(str(n)), range(12))
    assert sorted(heard, key=int) == [str(n) for n in range(12)]


@pytest.mark.parametrize("count", [1, 2])
def test_a_mistake_of_one_is_everybodys(count) -> None:
    with pytest.raises(ZeroDivisionError):
        Hands(count=count).each(lambda n: 1 / n, [1, 0, 2])
    with pytest.raises(ZeroDivisionError):
        Hands(count=count).both(lambda: 1, lambda: 1 // 0)


def test_without_a_hand_nothing_is_done() -> None:
    with pytest.raises(ValueError, match="0 threads"):
        Hands(count=0)
