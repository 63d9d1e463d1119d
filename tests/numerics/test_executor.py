"""Threads give the same results in the same order."""

import threading
import time
from dataclasses import dataclass

import pytest

from piezoid.numerics.executor import SERIAL, Executor, Once


@pytest.mark.parametrize("count", [1, 2, 5])
def test_results_keep_the_order_of_their_inputs(count):
    executor = Executor(threads=count)
    assert executor.map(lambda n: n * n, iter([3, 1, 2])) == [9, 1, 4]
    assert executor.map(str, []) == []
    assert executor.run_both(lambda: "one", lambda: 2) == ("one", 2)


def test_two_threads_run_at_the_same_time_and_a_serial_executor_in_the_caller():
    barrier = threading.Barrier(2, timeout=10.0)
    Executor(threads=2).map(lambda _: barrier.wait(), range(2))
    Executor(threads=2).run_both(barrier.wait, barrier.wait)
    threads = SERIAL.map(lambda _: threading.get_ident(), range(3))
    assert set(threads) == {threading.get_ident()}


def test_threads_report_one_at_a_time():
    lock, messages = threading.Lock(), []

    def report(text: str) -> None:
        assert lock.acquire(blocking=False)
        time.sleep(0.002)
        messages.append(text)
        lock.release()

    executor = Executor(progress=report, threads=4)
    executor.map(lambda n: executor.report(str(n)), range(12))
    assert sorted(messages, key=int) == [str(n) for n in range(12)]


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_in_a_thread_reaches_the_caller(count):
    with pytest.raises(ZeroDivisionError):
        Executor(threads=count).map(lambda n: 1 / n, [1, 0, 2])
    with pytest.raises(ZeroDivisionError):
        Executor(threads=count).run_both(lambda: 1, lambda: 1 // 0)
    with pytest.raises(ValueError, match="0 threads"):
        Executor(threads=0)


BARRIER = threading.Barrier(2, timeout=10.0)


@dataclass(frozen=True)
class Record:
    number: int

    @Once
    def values(self) -> list[int]:
        """Return a new list, so that identity shows whether it was cached."""
        BARRIER.wait()
        return [self.number]


def test_a_cached_value_is_computed_once_without_blocking_other_records():
    records = [Record(1), Record(2)]
    values = Executor(threads=2).map(lambda record: record.values, records)
    assert values == [[1], [2]]
    assert [record.values for record in records] == values
    assert records[0].values is values[0]
