"""The examples for microcontrollers, built for the chip and run on an emulated chip."""

import re
from pathlib import Path

import pytest

from piezoid.export.bundle import bundle
from tests.export.stage import stage as three_axes
from tests.runtime.compiler import SOURCE, attempt, require_tool, run, write_files
from tests.verification.rig import stage

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
CORE = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
FLAGS = ("-O2", "-ffp-contract=off", "-DPZ_REAL_FLOAT", "-Wall", "-Wextra", "-Werror")
CORE_Hz, RATE_Hz = 168e6, 20e3
INSTRUCTION_s = 8e-9  # of the emulator with -icount shift=3
# Declarations of the STM32 core for Arduino that the sketch uses.
ARDUINO = """\
#include <stdint.h>
#define A0 0
#define PA4 4
#define TIM2 ((void *)0)
enum { HERTZ_FORMAT };
uint32_t micros(void);
int analogRead(int);
void analogWrite(int, int), analogReadResolution(int), analogWriteResolution(int);
void delay(unsigned long);
struct HardwareTimer {
    explicit HardwareTimer(void *);
    void setOverflow(uint32_t, int), attachInterrupt(void (*)(void)), resume();
};
struct Stream {
    void begin(unsigned long);
    int available();
    float parseFloat();
    void print(const char *), print(unsigned long), println(const char *), println(unsigned long);
};
extern Stream Serial;
"""


@pytest.fixture
def folder(tmp_path):
    write_files(tmp_path / "bundle", bundle(stage("x")))
    return tmp_path


def build_program(folder, *flags, specs):
    program = folder / "controller.elf"
    example = EXAMPLES / "stm32f405"
    run(
        *(require_tool("arm-none-eabi-gcc"), "-std=c99", *FLAGS, "-Wconversion", *CORE, *flags),
        *("-nostartfiles", f"--specs={specs}", "-T", str(example / "stm32f405.ld")),
        *("-I", str(folder / "bundle"), str(example / "main.c")),
        *(str(folder / "bundle" / "piezoid_runtime.c"), "-o", str(program)),
    )
    return program


def test_the_interrupt_of_20_khz_has_time_to_spare_on_an_emulated_chip(folder):
    emulator = require_tool("qemu-system-arm")
    # The timer of the emulator counts at 1 GHz for any setting of the clock.
    program = build_program(
        folder, "-DPZ_EMULATED", "-DTIMER_Hz=1000000000u", specs="rdimon.specs"
    )
    output = run(
        *(emulator, "-machine", "netduinoplus2", "-icount", "shift=3", "-display", "none"),
        *("-serial", "none", "-monitor", "none"),
        *("-semihosting-config", "enable=on,target=native", "-kernel", str(program)),
    )
    steps, ticks, worst, missed = (int(word) for word in output.split())
    assert steps >= 4000
    assert missed == 0
    instructions = ticks / steps / CORE_Hz / INSTRUCTION_s
    assert 200 < instructions <= worst / CORE_Hz / INSTRUCTION_s < 0.5 * CORE_Hz / RATE_Hz


def test_the_program_for_the_chip_builds_without_a_warning_and_fits(folder):
    program = build_program(folder, specs="nosys.specs")
    size = run(require_tool("arm-none-eabi-size"), str(program)).splitlines()[1].split()
    assert int(size[0]) + int(size[1]) < 64 * 1024
    assert int(size[2]) < 16 * 1024


@pytest.mark.parametrize(
    ("example", "language", "axis"),
    [
        ("stm32f405/main.c", "c", ("#define AXIS 0", "#define AXIS 2")),
        ("arduino/piezoid.ino", "c++", ("const int AXIS = 0", "const int AXIS = 2")),
    ],
)
def test_the_examples_refuse_the_axis_of_a_tip(example, language, axis, tmp_path):
    write_files(tmp_path, bundle(three_axes()))
    (tmp_path / "Arduino.h").write_text(ARDUINO)
    compiler = (
        require_tool("c++", "g++") if language == "c++" else require_tool("cc", "gcc", "clang")
    )
    command = [compiler, "-w", "-fsyntax-only", "-DPZ_REAL_FLOAT", f"-I{tmp_path}", "-x", language]
    if language == "c++":
        command[1:1] = ["-include", "Arduino.h"]
    text = (EXAMPLES / example).read_text()
    for content, is_refused in ((text, False), (text.replace(*axis), True)):
        (tmp_path / "example").write_text(content)
        result = attempt(*command, str(tmp_path / "example"))
        assert (result.returncode != 0) is is_refused, result.stderr
        assert ("for position axes only" in result.stderr) is is_refused


@pytest.mark.parametrize("example", ["stm32f405/main.c", "arduino/piezoid.ino"])
def test_the_examples_saturate_a_voltage_beyond_their_converter(example, tmp_path):
    text = (EXAMPLES / example).read_text()
    constants = re.findall(r"^.*\bDRIVE_(?:V_PER_CODE|MAX_CODE)\b(?: =| \w).*\n", text, flags=re.M)
    function = re.search(r"^static \w+ drive_code.*?^}\n", text, flags=re.M | re.S)
    assert function is not None
    (tmp_path / "codes.cpp").write_text(
        '#include <cstdio>\n#include "piezoid_runtime.h"\n'
        + "".join([*constants[:2], function[0]])
        + "int main() {\n    const double volts[] = {-1e9, -0.1, 0, 5, 9.999, 10, 10.1, 1e9};\n"
        '    for (double v : volts) std::printf("%d ", (int)drive_code((pz_real)v));\n}\n'
    )
    program = str(tmp_path / "codes")
    run(require_tool("c++", "g++"), f"-I{SOURCE}", str(tmp_path / "codes.cpp"), "-o", program)
    assert run(program).split() == ["0", "0", "0", "2048", "4095", "4095", "4095", "4095"]


def test_the_sketch_is_sound_against_the_declarations_it_uses(folder):
    compiler = require_tool("arm-none-eabi-g++")
    (folder / "bundle" / "Arduino.h").write_text(ARDUINO)
    run(
        *(compiler, "-std=gnu++17", *FLAGS, "-Wno-missing-field-initializers", *CORE),
        *("-fsyntax-only", "-include", "Arduino.h", "-I", str(folder / "bundle")),
        *("-x", "c++", str(EXAMPLES / "arduino" / "piezoid.ino")),
    )
