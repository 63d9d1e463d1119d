"""A campaign as files, with the answer in a separate folder.

recordings/  one CSV per recording, lab.toml
truth/       truth.json: hidden effects with their sizes, and the noise; schema piezoid.truth/1
"""

import json
from pathlib import Path

from piezoid_datasets.virtual_lab.campaign import Campaign
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.stage import Rows

SCHEMA = "piezoid.truth/1"
AXIS = "x"
MICRONS_PER_M = 1e6


def campaign_files(campaign: Campaign) -> dict[str, bytes]:
    """Return the contents of the files of a campaign by relative path."""
    files = {
        f"recordings/{rows.run.name}.csv": csv_text(rows, axis=AXIS).encode()
        for rows in campaign.recordings
    }
    files["recordings/lab.toml"] = lab_toml(campaign.rig).encode()
    answer = campaign.answer
    truth = {  # sizes in percent of the stroke
        "schema": SCHEMA,
        "seed": answer.seed,
        "truth": answer.truth,
        "stroke_m": campaign.rig.stroke_m,
        "noise_rms_m": answer.noise_rms_m,
        "careless": answer.careless,
        "recordings": [rows.run.name for rows in campaign.recordings],
        "effects": [
            {
                "effect": effect.name,
                "measure": effect.measure.value,
                "asked_percent": effect.asked_percent,
                "measured_percent": effect.measured_percent,
                "rms_change_percent": dict(effect.change_percent),
                "numbers": dict(effect.numbers),
            }
            for effect in answer.effects
        ],
    }
    files["truth/truth.json"] = f"{json.dumps(truth, indent=1, allow_nan=False)}\n".encode()
    return files


def write_campaign(campaign: Campaign, folder: Path) -> None:
    """Write recordings/ and truth/ into a folder."""
    for name, content in campaign_files(campaign).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def lab_toml(rig: Rig) -> str:
    """Return the lab.toml of a rig, which declares the rig without hidden effects."""
    low, high = rig.converter_range_V
    tables: dict[str, dict[str, object]] = {
        "rig": {"name": rig.name},
        "amplifier": {
            "gain_V_per_V": rig.amplifier_gain_V_per_V,
            "bandwidth_Hz": rig.amplifier_bandwidth_Hz,
            "output_min_V": rig.amplifier_min_V,
            "output_max_V": rig.amplifier_max_V,
        },
        "sensor": {
            "bandwidth_Hz": rig.sensor_bandwidth_Hz,
            "gain_V_per_m": rig.sensor_gain_V_per_m,
        },
        "acquisition": {
            "sampling_rate_Hz": rig.clock_Hz,
            "dac_bits": rig.dac_bits,
            "adc_bits": rig.adc_bits,
            "input_range_V": [low, high],
        },
    }
    # JSON's strings, numbers and flat lists are TOML's as well
    return "\n".join(
        f"[{name}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items())
        for name, keys in tables.items()
    )


def csv_text(rows: Rows, *, axis: str = "") -> str:
    """Return the rows as CSV: time in s, voltage in V, displacement in um, other axes' voltages.

    axis  suffix of this axis' columns; empty while there is only one
    """
    mark = f"_{axis}" if axis else ""
    # Decimals that show the sampling interval exactly.
    interval_s = 1.0 / rows.run.sampling_rate_Hz
    decimals = next((n for n in range(1, 9) if abs(round(interval_s, n) - interval_s) < 1e-12), 9)
    names = ["time [s]", f"voltage{mark} [V]", f"displacement{mark} [um]"]
    names += [f"voltage_{name} [V]" for name in rows.others_V]
    columns = [
        [f"{value:.{decimals}f}" for value in rows.time_s.tolist()],
        [f"{value:.5f}" for value in rows.voltage_V.tolist()],
        [f"{value * MICRONS_PER_M:.5f}" for value in rows.displacement_m.tolist()],
    ]
    columns += [[f"{value:.5f}" for value in u.tolist()] for u in rows.others_V.values()]
    lines = [",".join(names), *(",".join(cells) for cells in zip(*columns, strict=True))]
    return "\n".join(lines) + "\n"
