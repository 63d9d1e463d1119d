"""What every page promises: one file, no network, the same bytes, headings and words for all."""

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


def test_the_same_records_give_the_same_bytes() -> None:
    assert page_of(axis_model()) == page_of(axis_model())


def test_the_page_asks_nothing_of_any_network(page: str) -> None:
    anatomy = Anatomy(page)
    for element in anatomy.elements:
        assert element.tag not in {"link", "img", "iframe", "object", "embed", "base", "form"}
        assert "src" not in element.attributes
        assert element.attributes.get("href", "#").startswith("#")
    assert not re.search(r"url\(|@import", anatomy.all("style")[0].text)


def test_the_policy_allows_our_script_and_style_and_nothing_else(page: str) -> None:
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
    # A style or a handler in an attribute would be stopped by the policy and heard as an error.
    for element in anatomy.elements:
        assert not [n for n in element.attributes if n == "style" or n.startswith("on")]


def test_headings_descend_one_step_at_a_time_from_a_single_first(page: str) -> None:
    levels = [int(e.tag[1]) for e in Anatomy(page).elements if re.fullmatch(r"h[1-6]", e.tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))


def test_identifiers_are_unique_and_links_lead_somewhere(page: str) -> None:
    anatomy = Anatomy(page)
    names = [e.attributes["id"] for e in anatomy.elements if "id" in e.attributes]
    assert len(set(names)) == len(names)
    assert {e.attributes["href"][1:] for e in anatomy.all("a")} <= set(names)
    labels = [e.attributes["aria-labelledby"] for e in anatomy.all("section")]
    assert set(labels) <= set(names)


def test_every_figure_says_in_words_what_it_shows_and_each_kind_has_one_guide(page: str) -> None:
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


def test_no_sentence_stands_twice_on_a_page() -> None:
    """Two axes with the same effects, in doubt about each other."""
    other = axis_model("y", ("up.csv", "down.csv"))
    other = replace(
        other,
        certificate=replace(other.certificate, remainder_m=8e-8, slew_V_per_s=41.0),
        quality=replace(other.quality, held_out_rms_m=4e-8, noise_rms_m=6e-9),
        uncertainty=replace(other.uncertainty, loop_width_m=(1.7e-6, 5e-8)),
    )
    found = diagnosed(finding("creep", rivals=("lag",)), finding("initial_state"))
    page = page_of(
        *(axis_model("x"), other),
        recordings=[
            recording(),
            recording("up.csv", "y", noise_m=8e-9),
            recording("down.csv", "y", noise_m=2e-8),
        ],
        diagnoses=(found, replace(found, axis="y", final=HeldOut(rms_m=2e-8, rms_percent=0.1))),
    )
    text = unescape(re.sub(r"<(style|script).*?</\1>|<[^>]+>", "\n", page, flags=re.DOTALL))
    sentences = [" ".join(s.split()) for s in re.split(r"(?<=[.;:])\s+|\n", text)]
    long = Counter(sentence for sentence in sentences if len(sentence) > 60)
    # The same digest belongs to several recordings here, and to no sentence.
    assert [s for s, n in long.items() if n > 1 and not s.startswith("sha256:")] == []


def test_buttons_drawings_and_tables_are_labelled(page: str) -> None:
    anatomy = Anatomy(page)
    assert len(anatomy.all("caption")) == len(anatomy.all("table")) > 5
    assert {e.attributes["scope"] for e in anatomy.all("th")} == {"col", "row"}
    for button in anatomy.all("button"):
        assert button.text.strip() or button.attributes.get("aria-label")
        assert button.attributes["type"] == "button"
    for svg in anatomy.all("svg"):
        if "svg" not in svg.inside:
            assert "aria-label" in svg.attributes or svg.attributes.get("aria-hidden") == "true"


def test_digests_of_recordings_and_model_stand_on_the_page(page: str) -> None:
    cells = [e.text for e in Anatomy(page).all("td", "digest")]
    assert cells.count("sha256:" + "0" * 64) == 3
    assert re.fullmatch(r"sha256:[0-9a-f]{64}", cells[-1])
    assert len(set(cells)) == 3  # the recordings', "none given", the model's
    other = replace(recording(), digest="sha256:" + "1" * 64)
    assert "another file" in page_of(axis_model(), recordings=[other])


def test_a_recording_of_a_million_samples_stays_light() -> None:
    rng = np.random.default_rng(3)
    given = recording()
    long = replace(
        given,
        channels=tuple(
            replace(c, values=np.tile(c.values, 350) + rng.normal(scale=5e-9, size=1_050_000))
            for c in given.channels
        ),
        breaks=(),
    )
    start = replace(axis_model().starts[1], last=1_050_000)
    page = page_of(replace(axis_model(), starts=(start,)), recordings=[long])
    figures = re.findall(r"<figure.*?</figure>", page, re.DOTALL)
    assert len(figures) > 4
    assert max(map(len, figures)) < LARGEST_FIGURE


def test_a_stage_of_six_axes_with_ten_recordings_each_stays_below_three_megabytes() -> None:
    names = tuple(f"{k}.csv" for k in range(10))
    axes = [axis_model(axis, names) for axis in "abcdef"]
    page = page_of(*axes, recordings=[_of_all_axes(name, "abcdef") for name in names])
    assert len(page.encode()) < LARGEST_PAGE
    loops = re.findall(r'<svg class="frame"[^>]*aria-label="\d\.csv, axis a: loop', page)
    assert len(loops) == 1 + MAX_PLOTTED
    rows = [e.text for e in Anatomy(page).all("th") if e.attributes["scope"] == "row"]
    assert rows.count("9.csv") >= 6  # in each axis' table


def _of_all_axes(name: str, axes: str):  # type: ignore[no-untyped-def]
    one = recording(name, axes[0], noise_m=2e-8)
    channels = [replace(c, axis=axis) for axis in axes for c in one.channels]
    return replace(one, channels=tuple(channels))


def _contrast(first: str, second: str) -> float:
    """Return the contrast of two colours as the Web Content Accessibility Guidelines define it."""

    def luminance(colour: str) -> float:
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted([luminance(first), luminance(second)])
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("mode", [0, 1], ids=["light", "dark"])
def test_texts_and_curves_stand_out_from_the_paper_and_curves_from_each_other(mode: int) -> None:
    style = (files("piezoid_reports") / "templates" / "style.css").read_text()
    block = re.findall(r":root \{(.*?)\}", style, re.DOTALL)[mode]
    colour = dict(re.findall(r"--(\w+): (#\w{6})", block))
    for text in ("ink", "soft", "good", "middling", "bad", "link"):
        for ground in ("paper", "panel"):
            assert _contrast(colour[text], colour[ground]) >= 4.5, (text, ground)
    for curve in ("measured", "model", "zero"):
        assert _contrast(colour[curve], colour["paper"]) >= 2.7, curve
    # Told apart by lightness alone, whatever hues an eye sees.
    assert _contrast(colour["measured"], colour["model"]) >= 1.9
