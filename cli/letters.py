"""Records sent from one process to another: their arrays as they lie in memory, not copied."""

import io
import pickle
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any


def send(channel: Connection, record: object) -> None:
    """Send a record whole; ``received`` at the other end of the channel gives it back.

    Only what a record holds besides its arrays becomes a letter: the arrays follow from where
    they are, and arrive read-only, as they are in a record.
    """
    arrays: list[pickle.PickleBuffer] = []
    letter = io.BytesIO()
    _Letter(letter, protocol=5, buffer_callback=arrays.append).dump(record)
    channel.send_bytes(len(arrays).to_bytes(8, "little"))
    channel.send_bytes(letter.getbuffer())
    for array in arrays:
        channel.send_bytes(array.raw())


def received(channel: Connection) -> Any:
    """Return what the other end sent; raises ``EOFError`` where it is gone."""
    count = int.from_bytes(channel.recv_bytes(), "little")
    letter = channel.recv_bytes()
    return pickle.loads(letter, buffers=[channel.recv_bytes() for _ in range(count)])


class _Letter(pickle.Pickler):
    def reducer_override(self, thing: object) -> Any:
        if isinstance(thing, MappingProxyType):  # which alone of what is frozen does not pickle
            return _view, (dict(thing),)
        return NotImplemented


def _view(held: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(held)
