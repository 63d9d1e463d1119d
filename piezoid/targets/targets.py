"""What `piezoid export` writes beside the bundle, by the name of its target."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from piezoid.errors import ParameterFileError
from piezoid.export.fmu import controller_units, fmu_files
from piezoid.export.shared_library import shared_library_files
from piezoid.targets.biquad import biquad_files
from piezoid.targets.exported import Exported
from piezoid.targets.nanonis import nanonis_files
from piezoid.targets.pi_pid import pi_pid_files
from piezoid.targets.plant_unit import plant_units
from piezoid.targets.waveform import waveform_files

BUNDLE = "bundle"


@dataclass(frozen=True, kw_only=True, eq=False)
class Written:
    """What the targets came to.

    files  name below the stage folder to bytes
    notes  sentences for whoever asked: what could not be made here, and why
    """

    files: Mapping[str, bytes]
    notes: tuple[str, ...]


Made = tuple[Mapping[str, bytes], tuple[str, ...]]


def _fmus(exported: Exported) -> Made:
    controllers = controller_units(exported.file)
    return fmu_files({**controllers, **plant_units(exported.file.name, exported.plants)})


def _library(exported: Exported) -> Made:
    return shared_library_files(exported.file)


# Each name is also that of the folder.
_MAKERS: dict[str, Callable[[Exported], Made]] = {
    "fmu": _fmus,
    "library": _library,
    "pi-pid": pi_pid_files,
    "biquad": biquad_files,
    "nanonis": nanonis_files,
    "waveform": waveform_files,
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


def written_for(exported: Exported, targets: Iterable[str]) -> Written:
    """Return the files of all targets but the bundle; the same input, the same bytes."""
    files: dict[str, bytes] = {}
    notes: list[str] = []
    for name in targets:
        if name in _MAKERS:
            made, said = _MAKERS[name](exported)
            files |= {f"{name}/{place}": content for place, content in made.items()}
            notes.extend(said)
    return Written(files=MappingProxyType(files), notes=tuple(notes))
