"""Tables for a Nanonis controller: its published interface, and lines on the plants."""

import csv
import inspect
import io
import json
import socket
import struct
import sys
import threading
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.targets.nanonis import (
    creep_after_move,
    hysteresis_table,
    line_errors_m,
    nanonis_files,
    settings_json,
)
from piezoid.targets.target_inputs import ControllerHardware
from tests.runtime.compiler import run, write_files
from tests.targets.known_inputs import exported


@cache
def made():
    return nanonis_files(exported())[0]


def calls(**others):
    inputs = replace(exported(), **others)
    tables = [hysteresis_table(inputs, axis) for axis in inputs.lateral]
    return json.loads(settings_json(inputs, tables))["calls"]


def test_names_and_order_are_those_of_the_published_package():
    package = pytest.importorskip("nanonis_spm")
    for name, arguments in calls().items():
        asked = list(inspect.signature(getattr(package.Nanonis, name)).parameters)[1:]
        assert asked == list(arguments)


def test_the_bytes_that_are_sent_hold_the_table(tmp_path):
    """send.py against a server of this test, decoded without that package."""
    pytest.importorskip("nanonis_spm")
    write_files(tmp_path, made())
    heard = {}

    def answer(connection):
        with connection:
            while len(header := connection.recv(40, socket.MSG_WAITALL)) == 40:
                name, size = header[:32].rstrip(b"\0").decode(), int.from_bytes(header[32:36])
                heard[name] = connection.recv(size, socket.MSG_WAITALL) if size else b""
                floats = {"Piezo.SensGet": 3, "Piezo.XYZLimitsGet": 6}.get(name, 0)
                body = b"\0\1" if "Limits" in name and floats else b""
                body += struct.pack(f">{floats}f", *range(10, 10 + floats)) + b"\0" * 8
                connection.sendall(header[:32] + len(body).to_bytes(4) + b"\0" * 4 + body)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=lambda: answer(server.accept()[0]))
        thread.start()
        said = run(
            sys.executable, "send.py", "127.0.0.1", str(server.getsockname()[1]), cwd=tmp_path
        )
        thread.join(timeout=10)
    table = hysteresis_table(exported(), exported().lateral[0])
    body = heard["Piezo.HystValsSet"]
    assert struct.unpack(">i", body[:4])[0] == 32
    np.testing.assert_array_equal(struct.unpack(">32f", body[4:132]), table.x_m)
    np.testing.assert_array_equal(struct.unpack(">32f", body[136:264]), table.y_m)
    # What the stage does not know, Y and Z, keeps what the controller answered
    assert struct.unpack(">3f", heard["Piezo.SensSet"]) == (table.sensitivity_m_per_V, 11.0, 12.0)
    assert "Piezo_SensSet" in said


def test_volts_are_those_at_the_piezo_where_the_amplifier_is_declared():
    command, piezo = calls(), calls(amplifier_V_per_V={"x": 15.0})
    ratio = (
        command["Piezo_SensSet"]["Calibration_X_mPerV"]
        / piezo["Piezo_SensSet"]["Calibration_X_mPerV"]
    )
    assert ratio == pytest.approx(15.0, rel=1e-6)
    ends = [c["Piezo_XYZLimitsSet"]["Limit_X_high_V"] for c in (command, piezo)]
    assert ends[1] == pytest.approx(15.0 * ends[0])
    assert "those of the command" in made()["README.md"].decode()


def test_the_table_straightens_forward_lines_of_every_plant():
    axis = exported().lateral[0]
    rows = line_errors_m(exported(), axis, hysteresis_table(exported(), axis))
    assert len(rows) == len(exported().family("x"))
    for row in rows.values():
        assert row["table"] < 0.5 * row["straight"]
        assert row["mirrored"] < row["back"]
    assert rows["identified"]["table"] < 0.2 * rows["identified"]["straight"]


def test_the_csv_is_the_table():
    rows = list(csv.DictReader(io.StringIO(made()["x.csv"].decode())))
    table = hysteresis_table(exported(), exported().lateral[0])
    for name, held in (("x_m", table.x_m), ("y_m", table.y_m)):
        np.testing.assert_array_equal(np.float32([float(row[name]) for row in rows]), held)
    assert json.loads(made()["nanonis.json"])["calls"] == calls()


def test_drift_is_what_the_shipped_creep_does_between_two_times():
    axis = exported().lateral[0]
    rate = np.zeros(8)
    share = np.zeros(8)
    rate[0], share[0] = -np.expm1(-1.0 / (50.0 * 20e3)), 0.01  # 1 % with 50 s
    known = replace(
        axis, values={**axis.values, "relaxation_rate": rate, "relaxation_share": share}
    )
    stage = replace(exported(), file=replace(exported().file, axes=(known,)))
    table = hysteresis_table(stage, known)
    speed, gone_m, left_m = creep_after_move(stage, table)
    wanted_m = 0.01 * table.half_m * (np.exp(-10.0 / 50.0) - np.exp(-100.0 / 50.0))
    assert gone_m == pytest.approx(wanted_m, rel=1e-6)
    assert speed == pytest.approx(wanted_m / 90.0, rel=1e-6)
    assert left_m < 0.5 * gone_m
    told = calls(file=stage.file)["Piezo_DriftCompSet"]
    assert told["Vx_m_s"] == pytest.approx(-speed, rel=1e-6)
    assert told["Compensation_on_off"] == 2


def test_a_frame_or_a_table_that_cannot_be_is_refused_with_what_would_fit():
    def refused(**asked):
        with pytest.raises(ParameterFileError) as error:
            nanonis_files(replace(exported(), hardware=ControllerHardware(**asked)))
        return str(error.value)

    assert "the distance from the centre to the limits" in refused(frame_half_range_m=1.0)
    assert "Set table_points =" in refused(table_points=3)
