"""render_fleet: a batch in, one self-contained HTML page out."""

from piezoid_reports.fleet.chapters import failures, outliers, stages, verdict
from piezoid_reports.fleet.findings import distributions
from piezoid_reports.fleet.records import Fleet
from piezoid_reports.fleet.spread import spread
from piezoid_reports.render import html


def render_fleet(fleet: Fleet) -> str:
    """Return summary.html, to lie beside the folder of the stages."""
    found = distributions(fleet)
    made = (verdict(fleet, found), failures(fleet), outliers(found), spread(found), stages(fleet))
    return html(f"Batch {fleet.name}", [section for section in made if section is not None])
