"""Properties of every page: no network access, equal bytes, headings, labels, size."""

import base64
import hashlib
import itertools
import re
from collections import Counter
from dataclasses import replace
from html import unescape
from importlib.resources import files

import numpy as np
import pytest

from piezoid.diagnosis.diagnosis import HeldOut
from piezoid_reports.page import MAX_PLOTTED
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, recording

LARGEST_PAGE = 3_000_000
LARGEST_FIGURE = 60_000


def test_the_same_records_give_the_same_bytes():
    assert page_of(axis_model()) == page_of(axis_model())


def test_the_page_has_no_network_access(page):
    anatomy = Anatomy(page)
    for element in anatomy.elements:
        assert element.tag not in {"link", "img", "iframe", "object", "embed", "base", "form"}
        assert "src" not in element.attributes
        assert element.attributes.get("href", "#").startswith("#")
    assert not re.search(r"url\(|@import", anatomy.all("style")[0].text)


def test_the_policy_allows_only_the_own_script_and_style(page):
    anatomy = Anatomy(page)
    policies = [
        e.attributes["content"] for e in anatomy.all("meta") if "http-equiv" in e.attributes
    ]
    assert len(policies) == 1
    for tag in ("script", "style"):
        inline = anatomy.all(tag)
        assert len(inline) == 1
        digest = hashlib.sha256(inline[0].text.encode()).digest()
        allowed = f"{tag}-src 'sha256-{base64.b64encode(digest).decode()}'"
        assert allowed in policies[0]
    assert "default-src 'none'" in policies[0]
    # The policy blocks styles and handlers in attributes.
    for element in anatomy.elements:
        assert not [n for n in element.attributes if n == "style" or n.startswith("on")]


def test_headings_descend_by_single_levels(page):
    levels = [int(e.tag[1]) for e in Anatomy(page).elements if re.fullmatch(r"h[1-6]", e.tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))


def test_identifiers_are_unique_and_links_have_targets(page):
    anatomy = Anatomy(page)
    names = [e.attributes["id"] for e in anatomy.elements if "id" in e.attributes]
    assert len(set(names)) == len(names)
    assert {e.attributes["href"][1:] for e in anatomy.all("a")} <= set(names)
    labels = [e.attributes["aria-labelledby"] for e in anatomy.all("section")]
    assert set(labels) <= set(names)


def test_every_figure_has_a_text_alternative_and_every_type_a_guide(page):
    anatomy = Anatomy(page)
    numbers = [int(n) for n in re.findall(r"<b>Figure (\d+)\.</b>", page)]
    assert numbers == list(range(1, len(numbers) + 1))
    frames, captions = anatomy.all("svg", "frame"), anatomy.all("figcaption")
    assert len(frames) == len(captions) == len(anatomy.all("figure", "chart")) > 8
    for frame in frames:
        assert frame.attributes["role"] == "img"
        assert re.search(r"\d", frame.attributes["aria-label"]), "no number in the alternative"
        assert re.search(r" in ([VsHm]|[µnm]m)\b", frame.attributes["aria-label"])
    guides = [e.text for e in anatomy.all("details", "look")]
    assert guides
    assert len(set(guides)) == len(guides)


def test_no_sentence_is_repeated_on_a_page():
    """The two axes have the same confounded effects."""
    axis = axis_model("y", ("up.csv", "down.csv"))
    axis = replace(
        axis,
        certificate=replace(axis.certificate, remainder_m=8e-8, slew_V_per_s=41.0),
        quality=replace(axis.quality, held_out_rms_m=4e-8, noise_rms_m=6e-9),
        uncertainty=replace(axis.uncertainty, loop_width_m=(1.7e-6, 5e-8)),
    )
    diagnosis = diagnosed(finding("creep", rivals=("lag",)), finding("initial_state"))
    page = page_of(
        *(axis_model("x"), axis),
        recordings=[
            recording(),
            recording("up.csv", "y", noise_m=8e-9),
            recording("down.csv", "y", noise_m=2e-8),
        ],
        diagnoses=(
            diagnosis,
            replace(diagnosis, axis="y", final=HeldOut(rms_m=2e-8, rms_percent=0.1)),
        ),
    )
    text = unescape(re.sub(r"<(style|script).*?</\1>|<[^>]+>", "\n", page, flags=re.DOTALL))
    sentences = [" ".join(s.split()) for s in re.split(r"(?<=[.;:])\s+|\n", text)]
    counts = Counter(sentence for sentence in sentences if len(sentence) > 60)
    # Several recordings have the same digest here.
    assert [s for s, n in counts.items() if n > 1 and not s.startswith("sha256:")] == []


def test_buttons_drawings_and_tables_are_labelled(page):
    anatomy = Anatomy(page)
    assert len(anatomy.all("caption")) == len(anatomy.all("table")) > 5
    assert {e.attributes["scope"] for e in anatomy.all("th")} == {"col", "row"}
    for button in anatomy.all("button"):
        assert button.text.strip() or button.attributes.get("aria-label")
        assert button.attributes["type"] == "button"
    for svg in anatomy.all("svg"):
        if "svg" not in svg.ancestors:
            assert "aria-label" in svg.attributes or svg.attributes.get("aria-hidden") == "true"


def test_the_page_states_digests_of_recordings_and_model(page):
    cells = [e.text for e in Anatomy(page).all("td", "digest")]
    assert cells.count("sha256:" + "0" * 64) == 3
    assert re.fullmatch(r"sha256:[0-9a-f]{64}", cells[-1])
    assert len(set(cells)) == 3  # of the recordings, "none given", of the model
    changed = replace(recording(), digest="sha256:" + "1" * 64)
    assert "another file" in page_of(axis_model(), recordings=[changed])


def test_a_recording_of_a_million_samples_has_small_figures():
    rng = np.random.default_rng(3)
    short = recording()
    long = replace(
        short,
        channels=tuple(
            replace(c, values=np.tile(c.values, 350) + rng.normal(scale=5e-9, size=1_050_000))
            for c in short.channels
        ),
        breaks=(),
    )
    start = replace(axis_model().starts[1], last=1_050_000)
    page = page_of(replace(axis_model(), starts=(start,)), recordings=[long])
    figures = re.findall(r"<figure.*?</figure>", page, re.DOTALL)
    assert len(figures) > 4
    assert max(map(len, figures)) < LARGEST_FIGURE


def test_six_axes_with_ten_recordings_each_stay_below_three_megabytes():
    names = tuple(f"{k}.csv" for k in range(10))
    axes = [axis_model(axis, names) for axis in "abcdef"]
    page = page_of(*axes, recordings=[recording_of_axes(name, "abcdef") for name in names])
    assert len(page.encode()) < LARGEST_PAGE
    loops = re.findall(r'<svg class="frame"[^>]*aria-label="\d\.csv, axis a: loop', page)
    assert len(loops) == 1 + MAX_PLOTTED
    rows = [e.text for e in Anatomy(page).all("th") if e.attributes["scope"] == "row"]
    assert rows.count("9.csv") >= 6  # in the table of each axis


def recording_of_axes(name: str, axes: str):  # type: ignore[no-untyped-def]
    original = recording(name, axes[0], noise_m=2e-8)
    channels = [replace(c, axis=axis) for axis in axes for c in original.channels]
    return replace(original, channels=tuple(channels))


def _contrast(first: str, second: str) -> float:
    """Return the contrast of two colours by the Web Content Accessibility Guidelines."""

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted([luminance(first), luminance(second)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("mode", [0, 1], ids=["light", "dark"])
def test_texts_and_curves_have_enough_contrast(mode):
    style = (files("piezoid_reports") / "templates" / "style.css").read_text()
    block = re.findall(r":root \{(.*?)\}", style, re.DOTALL)[mode]
    colour = dict(re.findall(r"--(\w+): (#\w{6})", block))
    for text in ("ink", "soft", "good", "middling", "bad", "link"):
        for ground in ("paper", "panel"):
            assert _contrast(colour[text], colour[ground]) >= 4.5, (text, ground)
    for curve in ("measured", "model", "zero"):
        assert _contrast(colour[curve], colour["paper"]) >= 2.7, curve
    # The curves differ in lightness, for readers who do not distinguish the hues.
    assert _contrast(colour["measured"], colour["model"]) >= 1.9
