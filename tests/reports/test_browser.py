"""The page in a browser: errors, network access, sizes and interaction of the figures."""

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
MAX_SCREENS, MAX_WORDS, MAX_SHEETS = 5, 900, 4  # of this stage of one axis

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def page() -> str:
    """A stage with a spectrum among its figures, and a long table."""
    return page_of(axis_model(), diagnoses=(diagnosed(finding("mains_interference")),))


def _browse(folder: Path, page: str, *arguments: str) -> tuple[str, str]:
    """Open a page; return the document and the output of the console."""
    path = folder / "report.html"
    path.write_text(page, encoding="utf-8")
    result = subprocess.run(
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
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return result.stdout, result.stderr


def _with_probe(page: str) -> str:
    digest = base64.b64encode(hashlib.sha256(PROBE.encode()).digest()).decode()
    allowed = page.replace("script-src ", f"script-src 'sha256-{digest}' ", 1)
    return allowed.replace("<style>", f"<script>{PROBE}</script><style>", 1)


@pytest.fixture(scope="module")
def probe(page: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("browser")
    document, console = _browse(folder, _with_probe(page), "--dump-dom", f"--window-size={PHONE}")
    body = Anatomy(document).all("body")[0]
    return {**json.loads(body.attributes["data-probe"]), "console": console}


@pytest.fixture(scope="module")
def desktop_probe(page: str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("desk")
    document, _ = _browse(folder, _with_probe(page), "--dump-dom", f"--window-size={DESK}")
    return dict(json.loads(Anatomy(document).all("body")[0].attributes["data-probe"]))


def test_a_desktop_shows_every_axis_and_its_keyboard_reaches_the_figures(desktop_probe):
    assert max(desktop_probe["rows"]) < SCREEN
    assert desktop_probe["sheet"] < MAX_SCREENS * SCREEN
    assert desktop_probe["words"] < MAX_WORDS
    assert desktop_probe["reached"] == desktop_probe["keys"] > 20
    assert desktop_probe["litNear"].startswith("M")
    assert desktop_probe["litAgain"] == ""


def test_the_residual_highlights_the_time_of_the_loop(desktop_probe):
    crosshair = desktop_probe["crosshair"]
    assert crosshair["visible"] == "visible"
    assert min(crosshair["width"], crosshair["height"]) > 50
    reading = r"(measured|model): drive \S+ V, displacement[a-z ]* \S+ µm, time (\S+) s"
    time_s = float(re.fullmatch(reading, desktop_probe["told"])[2])  # type: ignore[index]
    assert 0.0 < time_s < recording().duration_s
    assert desktop_probe["barOver"].count("M") == 1
    assert desktop_probe["barLeft"] == ""
    assert desktop_probe["barsNear"].count("M") > 0


def test_every_figure_saves_drawing_and_numbers(desktop_probe, page):
    kinds = [file["kind"] for file in desktop_probe["saved"]]
    assert kinds == ["image/svg+xml", "text/csv"] * page.count('<figure class="chart')
    assert min(file["size"] for file in desktop_probe["saved"]) > 100


def test_a_phone_has_no_errors_and_no_horizontal_scrolling(probe):
    assert probe["errors"] == []
    assert "CONSOLE" not in probe["console"]
    assert not probe["wide"]


def test_every_figure_and_every_curve_has_a_size(probe, page):
    assert len(probe["sizes"]) == page.count('<figure class="chart')
    for figure in probe["sizes"]:
        assert figure["width"] > 250
        assert figure["height"] > 100
        for width, height in figure["curves"]:
            assert width >= 0
            assert height >= 0
            assert width + height > 50


def test_the_pointer_reads_a_value_with_its_unit(probe):
    assert re.fullmatch(
        r"(measured|model): drive \S+ V, displacement[a-z ]* \S+ µm", probe["readout"]
    ), probe["readout"]
    # The ring lies on the curve at the pointer, to a pixel.
    assert probe["astray"] < 1.0


def test_a_double_click_restores_the_ticks_of_a_magnified_figure(probe):
    assert probe["near"] != probe["whole"]
    assert probe["ticksNear"] != probe["ticksBefore"]
    assert probe["again"] == probe["whole"]
    # The ticks of the script are those of the Python code.
    assert probe["ticksAgain"] == "".join(probe["ticksBefore"].split())


def test_the_script_draws_the_ticks_of_the_python_code(probe):
    assert {figure["decades"] for figure in probe["rewritten"]} == {"", "xy"}
    for figure in probe["rewritten"]:
        assert figure["after"] == figure["before"]


def test_the_wheel_magnifies_only_a_selected_figure(probe):
    assert probe["stolenWheel"] is False
    assert probe["keptWheel"] is True
    assert probe["byWheel"] != probe["whole"]


def test_curves_can_be_hidden_and_shown_again(probe):
    assert probe["hidden"] == "none"
    assert probe["after"] == 0


def test_a_page_that_violates_its_policy_logs_an_error(page, tmp_path):
    # This shows that the listener of the other tests detects errors.
    broken = page.replace("</body>", "<script>alert(1)</script></body>")
    _, console = _browse(tmp_path, broken, "--dump-dom")
    assert "CONSOLE" in console


def test_every_figure_prints_on_a_single_sheet(page, tmp_path):
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
    assert len(sheets) <= MAX_SHEETS
    figures = unfolded_figures(page)
    assert len(figures) > 4
    for number, numbers in figures:
        matching_sheets = [sheet for sheet in sheets if f"Figure {number}." in sheet]
        assert len(matching_sheets) == 1, number
        # The caption follows the figure it belongs to on the same sheet.
        first_word = numbers.split()[0]
        assert first_word in matching_sheets[0].partition(f"Figure {number}.")[2]


def unfolded_figures(page: str) -> list[tuple[int, str]]:
    """Return number and caption of each figure outside the folded details."""
    open_part = re.sub(
        r'<details class="(?:look|why|note)">.*?</details>', "", page, flags=re.DOTALL
    )
    while (shorter := re.sub(FOLD, "", open_part, flags=re.DOTALL)) != open_part:
        open_part = shorter
    captions = re.findall(
        r"<b>Figure (\d+)\.</b>.*?<figcaption><p>(.*?)</p>", open_part, flags=re.DOTALL
    )
    return [(int(number), unescape(text)) for number, text in captions]
