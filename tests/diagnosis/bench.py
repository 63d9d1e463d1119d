"""A healthy campaign of the virtual laboratory as recordings, and the view of them."""

import tempfile
from functools import cache
from pathlib import Path

from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.view import View
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign

PLANS = ("sweep", "rates", "staircase", "chirp", "other_axis")


def recorded(campaign: Campaign) -> tuple[tuple[Recording, ...], Lab]:
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_campaign(campaign, place)
        lab = read_lab(place / "recordings/lab.toml")
        files = [place / f"recordings/{rows.run.name}.csv" for rows in campaign.recordings]
        return tuple(ingest_all(files, lab)), lab


@cache
def healthy() -> tuple[tuple[Recording, ...], Lab]:
    return recorded(draw_campaign(20, truth="bouc_wen", plans=PLANS))


def view_of_recordings(recordings: tuple[Recording, ...], lab: Lab) -> View:
    return view_on(recordings, axis="x", lab=lab)


@cache
def healthy_view() -> View:
    return view_of_recordings(*healthy())
