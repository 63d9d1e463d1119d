"""What `piezoid export` writes beside the bundle, by the name of its target."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from piezoid.errors import ParameterFileError
from piezoid.export.fmu import fmus
from piezoid.export.parameter_file import ParameterFile
from piezoid.export.shared_library import shared_library_files

BUNDLE = "bundle"


@dataclass(frozen=True, kw_only=True, eq=False)
class Written:
    """What one target came to.

    files  name below the stage folder to bytes
    notes  sentences for whoever asked: what could not be made here, and why
    """

    files: Mapping[str, bytes]
    notes: tuple[str, ...]


Made = tuple[Mapping[str, bytes], tuple[str, ...]]

# Each name is also that of the folder.
_MAKERS: dict[str, Callable[[ParameterFile], Made]] = {
    "fmu": fmus,
    "library": shared_library_files,
}
TARGETS = (BUNDLE, *_MAKERS)


def known_targets(asked: Iterable[str]) -> tuple[str, ...]:
    """Return the targets asked for, each once; raise ``ParameterFileError`` for an unknown one."""
    wanted = tuple(dict.fromkeys(asked))
    for name in wanted:
        if name not in TARGETS:
            raise ParameterFileError(
                f"there is no target {name!r}",
                needed=f"one of {', '.join(TARGETS)}",
                remedy="Name one of these after --target, or none: the bundle is always written.",
            )
    return wanted


def written_for(file: ParameterFile, targets: Iterable[str]) -> Written:
    """Return the files of all targets but the bundle; the same input, the same bytes."""
    files: dict[str, bytes] = {}
    notes: list[str] = []
    for name in targets:
        if name in _MAKERS:
            made, said = _MAKERS[name](file)
            files |= {f"{name}/{place}": content for place, content in made.items()}
            notes.extend(said)
    return Written(files=MappingProxyType(files), notes=tuple(notes))
