"""Threads: the same result in the same order, whoever does it."""

import threading
import time
from dataclasses import dataclass

import pytest

from piezoid.numerics.executor import SERIAL, Executor, Once


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_come_in_the_order_of_what_was_asked(count) -> None:
    executor = Executor(threads=count)
    assert executor.map(lambda n: n * n, iter([3, 1, 2])) == [9, 1, 4]
    assert executor.map(str, []) == []
    assert executor.run_both(lambda: "one", lambda: 2) == ("one", 2)


def test_two_threads_work_at_the_same_time_and_one_does_not() -> None:
    together = threading.Barrier(2, timeout=10.0)
    Executor(threads=2).map(lambda _: together.wait(), range(2))
    Executor(threads=2).run_both(together.wait, together.wait)
    threads = SERIAL.map(lambda _: threading.get_ident(), range(3))
    assert set(threads) == {threading.get_ident()}


def test_threads_report_one_at_a_time() -> None:
    speaking, heard = threading.Lock(), []

    def told(text: str) -> None:
        assert speaking.acquire(blocking=False)
        time.sleep(0.002)
        heard.append(text)
        speaking.release()

    executor = Executor(progress=told, threads=4)
    executor.map(lambda n: executor.report(str(n)), range(12))
    assert sorted(heard, key=int) == [str(n) for n in range(12)]


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_of_one_thread_reaches_the_caller_and_no_thread_is_refused(count) -> None:
    with pytest.raises(ZeroDivisionError):
        Executor(threads=count).map(lambda n: 1 / n, [1, 0, 2])
    with pytest.raises(ZeroDivisionError):
        Executor(threads=count).run_both(lambda: 1, lambda: 1 // 0)
    with pytest.raises(ValueError, match="0 threads"):
        Executor(threads=0)


TOGETHER = threading.Barrier(2, timeout=10.0)


@dataclass(frozen=True)
class Record:
    number: int

    @Once
    def made(self) -> list[int]:
        """Return what is the same only if it is the same object."""
        TOGETHER.wait()
        return [self.number]


def test_records_make_their_values_once_and_at_the_same_time() -> None:
    records = [Record(1), Record(2)]
    first = Executor(threads=2).map(lambda record: record.made, records)
    assert first == [[1], [2]]
    assert [record.made for record in records] == first
    assert records[0].made is first[0]
