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
    model = page.model_digest
    sealed = {name: text for name, text in page.files.items() if name.endswith(".json")}
    digests = {name: digest_in(text) for name, text in sealed.items()}
    rows = [("lab.toml", page.model.lab or "none given", "the laboratory")]
    if page.lab is not None and page.lab.digest and page.lab.digest != page.model.lab:
        rows.append(("lab.toml, current", page.lab.digest, "the laboratory, after the fit"))
    if model:
        rows.append(("model.json", model, "the recordings in the model, lab.toml"))
    if "diagnosis.json" in page.files:
        rows.append(("diagnosis.json", digests["diagnosis.json"], "the recordings, lab.toml"))
    if page.design is not None and "design.json" in page.files:
        made_from = _of("model.json", page.design.model_digest, model)
        made_from += _lab(page, page.design.lab_digest)
        rows.append(("design.json", digests["design.json"], made_from))
    if "params.json" in page.files:
        sources = loads(page.files["params.json"])["sources"]
        made_from = _of("model.json", sources.get("model", ""), model)
        if "design.json" in page.files:
            design = _of("design.json", sources.get("design", ""), digests["design.json"])
            made_from += f", {design}"
        made_from += _lab(page, sources.get("lab", ""))
        rows.append(("params.json", digests["params.json"], made_from))
    verification = page.verification
    if verification is not None:
        runtime = ("runtime source, as shipped", verification.runtime_digest)
        rows.append((*runtime, "piezoid_runtime.h and .c"))
        if "verification.json" in page.files and "params.json" in page.files:
            expected = verification.parameters_digest
            made_from = _of("params.json", expected, digests["params.json"])
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


def _of(name: str, expected: str, actual: str) -> str:
    return name if expected == actual else f"another {name}: {expected[:19]}..."
