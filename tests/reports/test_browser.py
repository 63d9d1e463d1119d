"""The page in a real browser: no error, nothing asked of the network, every figure to be seen."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, recording

BROWSER = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
FOLD = r"<details(?:(?!<details).)*?</details>"  # an innermost one
PROBE = (Path(__file__).parent / "probe.js").read_text()
PHONE = "420,900"
DESK = "1440,1043"  # a window whose page is 900 high
SCREEN = 900
MOST_SCREENS, MOST_WORDS, MOST_SHEETS = 5, 900, 4  # of this stage of one axis

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def page() -> str:
    """A stage with a spectrum among its figures, and a long table."""
    return page_of(axis_model(), diagnoses=(diagnosed(finding("mains_interference")),))


def _browse(folder: Path, page: str, *arguments: str) -> tuple[str, str]:
    """Open a page; return the document and what the console said."""
    place = folder / "report.html"
    place.write_text(page, encoding="utf-8")
    done = subprocess.run(
        [
            str(BROWSER),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            f"--user-data-dir={folder / 'profile'}",
            "--enable-logging=stderr",
            "--v=0",
            *arguments,
            place.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout, done.stderr


def _with_probe(page: str) -> str:
    digest = base64.b64encode(hashlib.sha256(PROBE.encode()).digest()).decode()
    allowed = page.replace("script-src ", f"script-src 'sha256-{digest}' ", 1)
    return allowed.replace("<style>", f"<script>{PROBE}</script><style>", 1)


@pytest.fixture(scope="module")
def found(page: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("browser")
    document, console = _browse(folder, _with_probe(page), "--dump-dom", f"--window-size={PHONE}")
    body = Anatomy(document).all("body")[0]
    return {**json.loads(body.attributes["data-probe"]), "console": console}


@pytest.fixture(scope="module")
def at_a_desk(page: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("desk")
    document, _ = _browse(folder, _with_probe(page), "--dump-dom", f"--window-size={DESK}")
    return dict(json.loads(Anatomy(document).all("body")[0].attributes["data-probe"]))


def test_the_first_screen_holds_every_axis_and_the_page_is_short(
    at_a_desk: dict[str, Any],
) -> None:
    assert max(at_a_desk["rows"]) < SCREEN
    assert at_a_desk["sheet"] < MOST_SCREENS * SCREEN
    assert at_a_desk["words"] < MOST_WORDS


def test_folds_links_and_figures_are_reached_by_the_keyboard(at_a_desk: dict[str, Any]) -> None:
    assert at_a_desk["reached"] == at_a_desk["keys"] > 20


def test_the_time_seen_in_the_residual_is_lit_in_the_loop(at_a_desk: dict[str, Any]) -> None:
    assert at_a_desk["litNear"].startswith("M")
    assert at_a_desk["litAgain"] == ""


def test_the_time_over_the_loop_and_in_the_magnified_loop_is_lit_in_the_residual(
    at_a_desk: dict[str, Any],
) -> None:
    crosshair = at_a_desk["crosshair"]
    assert crosshair["visible"] == "visible"
    assert min(crosshair["width"], crosshair["height"]) > 50
    reading = r"(measured|model): drive \S+ V, displacement[a-z ]* \S+ µm, time (\S+) s"
    time_s = float(re.fullmatch(reading, at_a_desk["told"])[2])  # type: ignore[index]
    assert 0.0 < time_s < recording().duration_s
    assert at_a_desk["barOver"].count("M") == 1
    assert at_a_desk["barLeft"] == ""
    assert at_a_desk["barsNear"].count("M") > 0


def test_every_figure_saves_its_drawing_and_its_numbers(
    at_a_desk: dict[str, Any], page: str
) -> None:
    kinds = [one["kind"] for one in at_a_desk["saved"]]
    assert kinds == ["image/svg+xml", "text/csv"] * page.count('<figure class="chart')
    assert min(one["size"] for one in at_a_desk["saved"]) > 100


def test_neither_page_nor_console_hears_an_error(found: dict[str, Any]) -> None:
    assert found["errors"] == []
    assert "CONSOLE" not in found["console"]


def test_every_figure_and_every_curve_has_a_size(found: dict[str, Any], page: str) -> None:
    assert len(found["sizes"]) == page.count('<figure class="chart')
    for figure in found["sizes"]:
        assert figure["width"] > 250
        assert figure["height"] > 100
        for width, height in figure["curves"]:
            assert width >= 0
            assert height >= 0
            assert width + height > 50


def test_a_phone_need_not_scroll_sideways(found: dict[str, Any]) -> None:
    assert not found["wide"]


def test_the_pointer_reads_a_value_with_its_unit(found: dict[str, Any]) -> None:
    assert re.fullmatch(
        r"(measured|model): drive \S+ V, displacement[a-z ]* \S+ µm", found["readout"]
    ), found["readout"]
    # The ring stands on the curve under the pointer, to a pixel.
    assert found["astray"] < 1.0


def test_magnifying_moves_the_ticks_and_a_double_click_brings_them_back(
    found: dict[str, Any],
) -> None:
    assert found["near"] != found["whole"]
    assert found["ticksNear"] != found["ticksBefore"]
    assert found["again"] == found["whole"]
    # The script's ticks are those Python wrote.
    assert found["ticksAgain"] == "".join(found["ticksBefore"].split())


def test_even_and_logarithmic_ticks_of_every_figure_are_those_python_wrote(
    found: dict[str, Any],
) -> None:
    assert {figure["decades"] for figure in found["rewritten"]} == {"", "xy"}
    for figure in found["rewritten"]:
        assert figure["after"] == figure["before"]


def test_the_wheel_belongs_to_the_page_until_the_figure_is_chosen(found: dict[str, Any]) -> None:
    assert found["stolenWheel"] is False
    assert found["keptWheel"] is True
    assert found["byWheel"] != found["whole"]


def test_curves_can_be_hidden_and_shown_again(found: dict[str, Any]) -> None:
    assert found["hidden"] == "none"
    assert found["after"] == 0


def test_a_page_that_breaks_its_policy_is_heard(page: str, tmp_path: Path) -> None:
    # The listener of the tests above must be able to fail.
    broken = page.replace("</body>", "<script>alert(1)</script></body>")
    _, console = _browse(tmp_path, broken, "--dump-dom")
    assert "CONSOLE" in console


def test_it_prints_to_paper_with_every_figure_on_one_page(page: str, tmp_path: Path) -> None:
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext on this machine")
    _browse(tmp_path, page, "--no-pdf-header-footer", f"--print-to-pdf={tmp_path / 'page.pdf'}")
    text = subprocess.run(
        ["pdftotext", "-layout", str(tmp_path / "page.pdf"), "-"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    sheets = text.rstrip("\f").split("\f")
    assert len(sheets) <= MOST_SHEETS
    shown = _unfolded(page)
    assert len(shown) > 4
    for number, numbers in shown:
        holding = [sheet for sheet in sheets if f"Figure {number}." in sheet]
        assert len(holding) == 1, number
        # The caption follows the figure it belongs to on the same sheet.
        first_word = numbers.split()[0]
        assert first_word in holding[0].partition(f"Figure {number}.")[2]


def _unfolded(page: str) -> list[tuple[int, str]]:
    """Return number and caption of each figure that stands open, the first screen's aside."""
    bare = re.sub(r'<details class="(?:look|why|note)">.*?</details>', "", page, flags=re.DOTALL)
    while (shorter := re.sub(FOLD, "", bare, flags=re.DOTALL)) != bare:
        bare = shorter
    captions = re.findall(
        r"<b>Figure (\d+)\.</b>.*?<figcaption><p>(.*?)</p>", bare, flags=re.DOTALL
    )
    return [(int(number), unescape(text)) for number, text in captions]
