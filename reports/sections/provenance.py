"""Where every number comes from: digests of what went in and of what came out."""

from piezoid.identification.model import ActuatorModel
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid_reports.page import Listing, Page, Part, Prose, Section, Table
from piezoid_reports.quantities import told


def render(page: Page) -> Section:
    """Return the chain of digests, and what was odd about the files."""
    read: list[Recording | RawTable] = [*page.recordings, *page.sweeps]
    odd = [f"{held.name}: {problem.text}" for held in read for problem in held.problems]
    parts: list[Part] = [_recordings(page)] if page.recordings else []
    parts += [_sweeps(page)] if page.sweeps else []
    parts.append(_chain(page))
    if page.model.remarks:
        parts += [Prose(text="Recorded, but not used:"), Listing(items=page.model.remarks)]
    if odd:
        parts += [Prose(text="Noticed while reading the files:"), Listing(items=tuple(odd))]
    return Section(
        anchor="provenance",
        title="Provenance",
        lead="The same recordings and the same version give the same model and this same page, "
        "byte for byte. A file whose digest differs is not the one this page speaks of.",
        parts=tuple(parts),
    )


def _recordings(page: Page) -> Table:
    return Table(
        caption="Recordings.",
        columns=("recording", "axes", "samples", "rate", "duration", "in the model", "digest"),
        rows=tuple(
            (
                r.name,
                ", ".join(r.axes),
                str(r.samples),
                told(r.sampling_rate_Hz, "Hz", 4),
                told(r.duration_s, "s"),
                _agreement(page.model, r),
                r.digest,
            )
            for r in page.recordings
        ),
        digests=(6,),
    )


def _sweeps(page: Page) -> Table:
    return Table(
        caption="Tables over a height.",
        columns=("file", "over", "rows", "in the model", "digest"),
        rows=tuple(
            (t.name, t.independent, str(t.rows), _agreement(page.model, t), t.digest)
            for t in page.sweeps
        ),
        digests=(4,),
    )


def _agreement(model: ActuatorModel, recording: Recording | RawTable) -> str:
    if recording.name not in model.sources:
        return "no"
    return "yes" if model.sources[recording.name] == recording.digest else "another file"


def _chain(page: Page) -> Table:
    lab = page.model.lab or "none given"
    return Table(
        caption="What the laboratory declared, and what was written.",
        columns=("record", "digest"),
        rows=(("lab.toml", lab), ("model.json", page.model_digest)),
        digests=(1,),
    )
