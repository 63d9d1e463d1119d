"""Values a record keeps of itself: made once, and nobody waits for another record's."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Barrier

from piezoid.numerics.executor import Once

TOGETHER = Barrier(2, timeout=10.0)


@dataclass(frozen=True)
class Record:
    number: int

    @Once
    def made(self) -> list[int]:
        """Return what is the same only if it is the same object."""
        return [self.number]

    @Once
    def met(self) -> int:
        """Return the number once another record is being asked as well."""
        TOGETHER.wait()
        return self.number


def test_a_value_is_made_once_for_each_record() -> None:
    one, other = Record(1), Record(2)
    assert one.made is one.made
    assert (one.made, other.made) == ([1], [2])


def test_two_records_make_their_values_at_the_same_time() -> None:
    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(lambda record: record.met, (Record(1), Record(2)))) == [1, 2]
