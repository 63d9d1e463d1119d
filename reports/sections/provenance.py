"""Provenance: digests of the recordings and of the files made from them."""

from json import loads

from piezoid.digests import digest_in
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.recording import Recording
from piezoid.records.table import RawTable
from piezoid_reports.page import Page
from piezoid_reports.parts import Section, Table, with_rows
from piezoid_reports.quantities import number


def render(page: Page) -> Section:
    """Return the tables of recordings and of the chain of digests."""
    recordings = Table(
        caption="Recordings.",
        columns=("recording", "axes", "samples", "rate", "duration", "in the model", "digest"),
        rows=tuple(
            (
                r.name,
                ", ".join(r.axes),
                str(r.samples),
                number(r.sampling_rate_Hz, "Hz", 4),
                number(r.duration_s, "s"),
                _agreement(page.model, r),
                r.digest,
            )
            for r in page.recordings
        ),
        digests=(6,),
    )
    sweeps = Table(
        caption="Tables over a height.",
        columns=("file", "over", "rows", "in the model", "digest"),
        rows=tuple(
            (t.name, t.independent, str(t.rows), _agreement(page.model, t), t.digest)
            for t in page.sweeps
        ),
        digests=(4,),
    )
    return Section(
        anchor="provenance",
        title="Provenance",
        lead="The same recordings and version give the same files, byte for byte.",
        parts=(*with_rows(recordings, sweeps), _chain(page)),
    )


def _agreement(model: ActuatorModel, recording: Recording | RawTable) -> str:
    if recording.name not in model.sources:
        return "no"
    return "yes" if model.sources[recording.name] == recording.digest else "another file"


def _chain(page: Page) -> Table:
    files, verification = page.files, page.verification
    digests = {name: digest_in(text) for name, text in files.items() if name.endswith(".json")}

    def source(name: str, expected: str) -> str:
        actual = page.model_digest if name == "model.json" else digests[name]
        return name if expected == actual else f"another {name}: {expected[:19]}..."

    rows = [("lab.toml", page.model.lab or "none given", "the laboratory")]
    if page.lab is not None and page.lab.digest and page.lab.digest != page.model.lab:
        rows.append(("lab.toml, current", page.lab.digest, "the laboratory, after the fit"))
    if page.model_digest:
        rows.append(("model.json", page.model_digest, "the recordings in the model, lab.toml"))
    if "diagnosis.json" in files:
        rows.append(("diagnosis.json", digests["diagnosis.json"], "the recordings, lab.toml"))
    if page.design is not None and "design.json" in files:
        made_from = source("model.json", page.design.model_digest)
        made_from += _lab(page, page.design.lab_digest)
        rows.append(("design.json", digests["design.json"], made_from))
    if "params.json" in files:
        sources = loads(files["params.json"])["sources"]
        made_from = source("model.json", sources.get("model", ""))
        if "design.json" in files:
            made_from += f", {source('design.json', sources.get('design', ''))}"
        made_from += _lab(page, sources.get("lab", ""))
        rows.append(("params.json", digests["params.json"], made_from))
    if verification is not None:
        runtime = verification.runtime_digest
        rows.append(("runtime source, as shipped", runtime, "piezoid_runtime.h and .c"))
        if "verification.json" in files and "params.json" in files:
            made_from = source("params.json", verification.parameters_digest)
            made_from += ", this runtime source, model.json"
            made_from += _lab(page, verification.lab_digest)
            rows.append(("verification.json", digests["verification.json"], made_from))
    return Table(
        caption="Digests of the files and of their inputs.",
        columns=("record", "digest", "made from"),
        rows=tuple(rows),
        digests=(1,),
    )


def _lab(page: Page, digest: str) -> str:
    """Return whether a record was made with the lab.toml of the fit, with another one, or none."""
    fitted = page.model.lab or ""
    if digest == fitted:
        return ", lab.toml" if digest else ""
    return f", another lab.toml: {digest[:19]}..." if digest else ", no lab.toml"
