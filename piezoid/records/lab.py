"""lab.toml: declarations about a rig and its files that recordings do not contain.

``lab_tables.py`` has a class for each table, with its keys; ``[verification]`` holds limits by
name. ``[axis.z.sensor]`` and the like hold the same tables for one axis, each replacing the common
one. Everything is optional. An unknown name is refused, because it is usually a typing error.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import product
from os.path import exists, realpath
from pathlib import Path

import msgspec

from piezoid.digests import digest_of_bytes, digest_of_json
from piezoid.errors import LabFileError
from piezoid.records.lab_tables import (
    GUARDS,
    Acquisition,
    Actuator,
    Amplifier,
    AxisRig,
    Certificates,
    Coupled,
    RecordingEntry,
    RigName,
    Sensor,
    Table,
    Tunnelling,
    check_numbers,
    check_range,
    lab_error,
)
from piezoid.records.readers.reader import TextFormat, regular_size
from piezoid.toml_files import read_toml

__all__ = (
    "Acquisition",
    "Actuator",
    "Amplifier",
    "AxisRig",
    "Certificates",
    "Coupled",
    "Lab",
    "RecordingEntry",
    "Sensor",
    "Tunnelling",
    "read_lab",
)


_MAX_bytes = 1 << 22  # entries of fifty thousand files
_MAX_PARTS = 256  # of one file; each is read separately


class _Contents(
    Table,
    frozen=True,
    kw_only=True,
    rename={"certificates": "uncertainty", "recordings": "recording", "axes": "axis"},
):
    rig: RigName = RigName()
    amplifier: Amplifier = Amplifier()
    actuator: Actuator = Actuator()
    sensor: Sensor = Sensor()
    acquisition: Acquisition = Acquisition()
    tunnelling: Tunnelling = Tunnelling()
    verification: dict[str, float] = msgspec.field(default_factory=dict)
    certificates: Certificates = Certificates()
    coupled: Coupled = Coupled()
    recordings: tuple[RecordingEntry, ...] = ()
    axes: dict[str, AxisRig] = msgspec.field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Lab:
    """Contents of lab.toml; the defaults declare nothing.

    name         from ``[rig]``
    place        the file's name, for messages
    folder       folder to which the names of recordings are relative
    digest       of the file's bytes, empty without a file
    amplifier, actuator, sensor, acquisition, tunnelling   its tables
    verification  limits by name; the verification knows the names
    certificates  certified properties of the sensor and the room
    coupled      axes with mutual coupling
    recordings   its ``[[recording]]`` entries
    axes         tables of single axes
    """

    name: str = ""
    place: str = "lab.toml"
    folder: Path = Path()
    digest: str = ""
    amplifier: Amplifier = field(default_factory=Amplifier)
    actuator: Actuator = field(default_factory=Actuator)
    sensor: Sensor = field(default_factory=Sensor)
    acquisition: Acquisition = field(default_factory=Acquisition)
    tunnelling: Tunnelling = field(default_factory=Tunnelling)
    verification: dict[str, float] = field(default_factory=dict)
    certificates: Certificates = field(default_factory=Certificates)
    coupled: Coupled = field(default_factory=Coupled)
    recordings: tuple[RecordingEntry, ...] = ()
    axes: dict[str, AxisRig] = field(default_factory=dict)

    @property
    def rig_digest(self) -> str:
        """Digest of the declarations that the design uses: the rig without the tip guards."""
        return self._digest_without(GUARDS)

    @property
    def control_digest(self) -> str:
        """Digest of the declarations that controller and plant use: the rig and the tip guards."""
        return self._digest_without(())

    def _digest_without(self, guards: tuple[str, ...]) -> str:
        names = ("amplifier", "actuator", "sensor", "acquisition", "axes", "tunnelling")
        tables = {name: msgspec.to_builtins(getattr(self, name)) for name in names}
        for guard in guards:
            del tables["tunnelling"][guard]
        return digest_of_json(tables)

    def amplifier_of(self, axis: str) -> Amplifier:
        """Return the amplifier of an axis: its table, or else the common one.

        >>> piezoid.read_lab("lab.toml").amplifier_of("x").bandwidth_Hz
        4000.0
        """
        return self.axes.get(axis, AxisRig()).amplifier or self.amplifier

    def actuator_of(self, axis: str) -> Actuator:
        """Return the actuator of an axis: its table, or else the common one.

        >>> piezoid.read_lab("lab.toml").actuator_of("x").bandwidth_Hz
        12000.0
        """
        return self.axes.get(axis, AxisRig()).actuator or self.actuator

    def sensor_of(self, axis: str) -> Sensor:
        """Return the sensor of an axis: its table, or else the common one.

        >>> piezoid.read_lab("lab.toml").sensor_of("x").bandwidth_Hz
        8500.0
        """
        return self.axes.get(axis, AxisRig()).sensor or self.sensor

    def entries_of(self, path: Path) -> tuple[RecordingEntry, ...]:
        """Return the entries about a file: those of its path, or else those of its bare name.

        >>> from pathlib import Path
        >>> piezoid.read_lab("lab.toml").entries_of(Path("sweep.csv"))
        ()
        """
        # Unlike Path.resolve, realpath accepts circular links.
        target = realpath(path)
        entries = [e for e in self.recordings if realpath(self.folder / e.file) == target]
        entries = entries or [e for e in self.recordings if Path(e.file).name == path.name]
        if len(entries) > _MAX_PARTS:
            raise lab_error(
                f"{self.place}: {len(entries)} entries are about {path.name}",
                f"at most {_MAX_PARTS} parts of one file",
            )
        return tuple(entries)

    def text_format_of(self, path: Path) -> TextFormat:
        """Return the declared layout of a text table, which must be the same in all its entries.

        >>> from pathlib import Path
        >>> piezoid.read_lab("lab.toml").text_format_of(Path("sweep.csv")).decimal
        """
        formats = {
            TextFormat(
                separator="" if e.separator == " " else e.separator,
                decimal=e.decimal,
                heading_row=e.heading_row,
            )
            for e in self.entries_of(path)
        }
        if len(formats) > 1:
            raise lab_error(
                f"{self.place}: the {len(formats)} entries about {path.name} differ in separator, "
                "decimal or heading_row",
                "the same separator, decimal and heading_row in each of its entries",
            )
        return formats.pop() if formats else TextFormat()

    def check_files(self, paths: Iterable[Path]) -> None:
        """Refuse an entry whose file neither exists nor is read: its name is misspelt.

        The copy of lab.toml that a fit saves next to its model.json is not checked, since it names
        files relative to another folder.

        >>> from pathlib import Path
        >>> piezoid.read_lab("lab.toml").check_files([Path("sweep.csv")])
        """
        if (self.folder / "model.json").exists():
            return
        paths = list(paths)
        names = {realpath(path) for path in paths} | {path.name for path in paths}
        for entry in self.recordings:
            path = self.folder / entry.file
            if realpath(path) in names or path.name in names or exists(path):
                continue
            without_entry = [p.name for p in paths if not self.entries_of(p)]
            similar = get_close_matches(path.name, without_entry, n=1)
            hint = f"; {similar[0]!r} has a similar name and no entry" if similar else ""
            raise lab_error(
                f"{self.place}: [[recording]] {entry.file!r} is about a file that is neither in "
                f"the folder of {self.place} nor among those to be read{hint}",
                "the name of a recording, from the folder of lab.toml",
            )


def read_lab(path: Path) -> Lab:
    """Read and check a lab.toml; errors name the invalid line or table."""
    try:
        size = regular_size(path)
        if size > _MAX_bytes:
            raise lab_error(f"{path.name}: it has {size} bytes", f"at most {_MAX_bytes}")
        with path.open("rb") as stream:
            content = stream.read(size)
        record = read_toml(content.decode("utf-8-sig"))
    except FileNotFoundError as error:
        raise LabFileError(
            f"there is no file {path}",
            needed="a lab.toml",
            remedy="Check its name, or write one with `piezoid init RECORDINGS`.",
        ) from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise lab_error(f"{path.name}: {reason}", "a file that can be read") from error
    except ValueError as error:
        raise lab_error(f"{path.name}: {error}", "text in TOML, UTF-8") from error
    try:
        contents = msgspec.convert(record, _Contents, strict=True)
    except msgspec.ValidationError as error:
        message, _, location = str(error).partition(" - at `$")
        table = location.rstrip("`").lstrip(".") or "the top"
        unknown = message.partition("unknown field `")[2].rstrip("`").lower()
        tables = Table.__subclasses__()
        names = {name.lower(): name for t in tables for name in t.__struct_encode_fields__}
        similar = get_close_matches(unknown, names, n=1)
        hint = f" (did you mean {names[similar[0]]}?)" if similar else ""
        needed = f"the names and types of a lab.toml{hint}"
        raise lab_error(f"{path.name}: {table}: {message}", needed) from error
    tables_of_lab = msgspec.structs.asdict(contents)
    lab = Lab(
        name=tables_of_lab.pop("rig").name,
        place=path.name,
        folder=path.parent,
        digest=digest_of_bytes(content),
        **tables_of_lab,
    )
    _check_tables(lab)
    return lab


def _check_tables(lab: Lab) -> None:
    """Refuse impossible numbers and names, and a key without effect for lack of another one."""
    names = ("amplifier", "actuator", "sensor", "acquisition", "tunnelling")
    tables: list[tuple[str, Table]] = [(f"[{name}]", getattr(lab, name)) for name in names]
    tables += [("[uncertainty]", lab.certificates), ("[coupled]", lab.coupled)]
    for name, rig in lab.axes.items():
        of_axis = ((key, getattr(rig, key)) for key in rig.__struct_fields__)
        tables += [(f"[axis.{name}.{key}]", table) for key, table in of_axis if table is not None]
    for heading, table in tables:
        check_numbers(f"{lab.place}: {heading}", table)
    for entry in lab.recordings:
        location = f"{lab.place}: [[recording]] {entry.file!r}"
        check_numbers(location, entry)
        check_range(location, "start_s, stop_s", entry.start_s, entry.stop_s)
        if "\0" in entry.file:
            raise lab_error(f"{location} holds a zero character", "the name of a file")
        mark = "," if entry.separator is None else entry.separator
        if len(mark) != 1 or mark.isalnum() or mark == ".":
            needed = 'one character, as ";", "\\t" or " " for any white space'
            raise lab_error(f"{location} separator is {mark[:20]!r}", needed)

    # A key that has no effect because another key is missing.
    def refuse(is_violated: bool, problem: str, needed: str) -> None:
        if is_violated:
            raise lab_error(f"{lab.place}: {problem}", needed)

    axes, converter = lab.coupled.axes, lab.acquisition
    is_repeated = len(set(axes)) != len(axes) or len(axes) == 1
    refuse(is_repeated, f"[coupled] axes are {list(axes)}", "two axes or more, each once")
    for key in ("dac_bits", "adc_bits"):
        refuse(
            getattr(converter, key) is not None and converter.input_range_V is None,
            f"[acquisition] declares {key} and no input_range_V",
            "input_range_V = [low, high], the volts of all codes",
        )
    refuse(
        lab.coupled.settling_periods != Coupled().settling_periods and not axes,
        "[coupled] declares settling_periods and no axes",
        "the names of the axes that are coupled",
    )
    for (name, rig), key in product(
        lab.axes.items(), ("output_min_V", "output_max_V", "slew_V_per_s")
    ):
        refuse(
            rig.amplifier is not None
            and getattr(lab.amplifier, key) is not None
            and getattr(rig.amplifier, key) is None,
            f"[amplifier] limits {key}, and [axis.{name}.amplifier] does not",
            f"{key} of axis {name}: its table replaces [amplifier]",
        )
