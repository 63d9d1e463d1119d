"""HTML representation of records in notebooks."""

from dataclasses import replace

from piezoid.digests import digest_of_bytes
from piezoid.summary import Summary
from tests.reports.anatomy import Anatomy
from tests.reports.known_stage import axis_model, recording, stage_model


def test_a_notebook_shows_numbers_and_no_markup_of_names():
    table = Anatomy(recording()._repr_html_())
    assert "500 Hz" in table.all("table")[0].text
    assert digest_of_bytes(b"")[:7] in table.all("table")[0].text
    assert "30.0 nm rms" in stage_model(axis_model())._repr_html_()
    refused = stage_model(axis_model(reason="it turns back"))
    assert "does not apply: it turns back" in refused._repr_html_()
    hostile = replace(recording(), name="<script>alert(1)</script>.csv")
    assert "<script" not in hostile._repr_html_()
    table = Summary(title="<b>", headings=("<b>",), rows=[("<b>",)], notes=("<b>",))
    assert "<b>" not in table._repr_html_()
