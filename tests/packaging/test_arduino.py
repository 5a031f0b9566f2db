"""The Arduino library, built by arduino-builder for an AVR and run in simavr."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
import threading
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from triangle import PARAMS, ROOT, host_codes, run

BOARDS = {"atmega328p": "arduino:avr:uno", "atmega2560": "arduino:avr:mega:cpu=atmega2560"}
BUILT_IN = "/usr/share/arduino/hardware/arduino/avr/libraries"
SKETCHES = {"f32": "Track", "q31": "TrackFixedPoint"}


@pytest.fixture(scope="module")
def libraries(package: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An Arduino libraries directory with nothing but the unpacked archive."""
    folder = tmp_path_factory.mktemp("arduino")
    with zipfile.ZipFile(package.make("arduino", folder)) as archive:
        archive.extractall(folder / "libraries")
    return folder / "libraries"


def build(libraries: Path, sketch: Path, board: str, folder: Path, stand_ins: Path | None = None) -> Path:
    """`stand_ins`: a directory of headers that come before those of all libraries."""
    first = f" -I{stand_ins}" if stand_ins else ""
    folder.mkdir()
    done = subprocess.run([
        "arduino-builder", "-compile", "-hardware", "/usr/share/arduino/hardware", "-hardware",
        "/usr/share/arduino-builder", "-tools", "/usr/bin", "-built-in-libraries", BUILT_IN, "-libraries", libraries, "-fqbn", board, "-build-path", folder,
        # The core of Debian 12 needs it, and its avr-gcc 5.4 defines it for C only.
        "-prefs", f"compiler.cpp.extra_flags=-DDECIMAL_DIG=__DECIMAL_DIG__{first}",
        sketch], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / f"{sketch.name}.elf"


def sketch_of(folder: Path, *parts: str) -> Path:
    """A sketch of these pieces of C++, with the actuator of the examples beside it."""
    path = folder / "Dac/Dac.ino"
    path.parent.mkdir()
    path.write_text("\n".join(parts))
    path.with_name("rdpi_params.h").write_bytes((PARAMS / "rdpi_params.h").read_bytes())
    return path


def prints(program: Path, chip: str) -> list[str]:
    """What a program sends over its serial line until "end". simavr adds colours, and dots for control characters."""
    lines = []
    simulator = subprocess.Popen(["simavr", "-m", chip, "-f", "16000000", program], stdout=subprocess.PIPE,
                                 stderr=subprocess.STDOUT, text=True)
    limit = threading.Timer(60, simulator.kill)
    limit.start()
    try:
        for line in simulator.stdout:
            lines.append(re.sub(r"\x1b\[\d+m|\.+\n", "", line))
            if lines[-1] == "end":
                return lines[:-1]
    finally:
        limit.cancel()
        simulator.kill()
        simulator.communicate()
    raise AssertionError(f"no end: {lines}")


@pytest.mark.parametrize("chip", BOARDS)
@pytest.mark.parametrize("engine", SKETCHES)
def test_a_sketch_outputs_the_codes_of_the_host(libraries: Path, codes: dict[str, list[int]], tmp_path: Path, engine: str,
                                                chip: str) -> None:
    name = SKETCHES[engine]
    program = build(libraries, libraries / f"rdpi/examples/{name}/{name}.ino", BOARDS[chip], tmp_path / "build")
    status, *said = prints(program, chip)
    assert status == "status 0"
    assert [int(line) for line in said] == codes[engine]


WIRE, TICKS, SPI = re.findall(r"^```cpp\n(.*?)^```", (ROOT / "lib/packaging/README.md").read_text(), re.MULTILINE | re.DOTALL)
START_TIMER = """
static void start_timer() /* 1 kHz */
{
    TCCR1A = 0;
    TCCR1B = _BV(WGM12) | _BV(CS11);
    OCR1A = 1999;
    TIMSK1 = _BV(OCIE1A);
}
"""
# On a bus that prints what it is given, or on Wire: 20 ticks, one code each, as the library has computed them.
FOLLOW = """
#include <rdpi.h>
#include <drivers/mcp4725.h>
#include "rdpi_params.h"

static rdpi_mcp4725_t dac;
static rdpi_f32_t axis;
static uint8_t done;

void setup()
{
    const rdpi_mcp4725_config_t config = {0x62};
    Serial.begin(115200);
    WIRE_BEGIN
    Serial.println((int)rdpi_f32_init(&axis, &rdpi_params, 0.001f));
    rdpi_mcp4725_init(&dac, &config);
    start_timer();
}

void loop()
{
    if (take_ticks() == 0 || done > 20) {
        return;
    }
    rdpi_f32_step(&axis, 0.05f * done);
    uint16_t code = axis.dac_code >> 4; /* the parameters are for 16 bits */
    if (!rdpi_mcp4725_start(&dac, code) || !rdpi_mcp4725_write(&dac, code)) {
        Serial.println("held");
    }
    if (done++ == 20) {
        Serial.println(dac.fail_count);
        Serial.println("end");
    }
}
"""
PRINTING_BUS = """
#include <rdpi_i2c.h>

void rdpi_i2c_write(uint8_t address, const uint8_t *bytes, size_t count)
{
    static uint8_t calls;
    if (calls++ > 0) { /* the first is that of start */
        Serial.println(((uint32_t)address << 8 | count) << 16 | (uint16_t)(bytes[0] << 8 | bytes[1]));
    }
}

rdpi_i2c_state_t rdpi_i2c_state(void)
{
    return RDPI_I2C_DONE;
}
"""
DAC_ON_THE_SPI = """
#include <drivers/mcp4922.h>

static rdpi_mcp4922_t dac;

void setup()
{
    const rdpi_mcp4922_config_t config = {false, false};
    Serial.begin(115200);
    SPI.begin();
    pinMode(CHIP_SELECT, OUTPUT);
    digitalWrite(CHIP_SELECT, HIGH);
    rdpi_mcp4922_init(&dac, &config);
    Serial.println(rdpi_mcp4922_write(&dac, 0, 4095));
    Serial.println(rdpi_mcp4922_write(&dac, 0, 4096));
    Serial.println(dac.code_count);
    Serial.println("end");
}

void loop()
{
}
"""


def test_a_driver_on_the_i2c_gets_the_codes_of_loop_to_its_bus(libraries: Path, codes: dict[str, list[int]],
                                                              tmp_path: Path) -> None:
    """An interrupt counts, loop computes and calls the driver."""
    sketch = sketch_of(tmp_path, PRINTING_BUS, TICKS, START_TIMER, FOLLOW.replace("WIRE_BEGIN", ""))
    status, *said, failed = prints(build(libraries, sketch, BOARDS["atmega328p"], tmp_path / "build"), "atmega328p")
    assert (status, failed) == ("0", "0")
    assert [int(line) for line in said] == [0x62020000 | code >> 4 for code in codes["f32"][:21]]


def test_wire_in_loop_returns_and_tells_that_no_dac_answers(libraries: Path, tmp_path: Path) -> None:
    sketch = sketch_of(tmp_path, WIRE, TICKS, START_TIMER,
                       FOLLOW.replace("WIRE_BEGIN", "Wire.begin();\n    Wire.setClock(400000);"))
    said = prints(build(libraries, sketch, BOARDS["atmega328p"], tmp_path / "build"), "atmega328p")
    assert said == ["0", *21 * ["held"], "21"]


def test_a_driver_on_the_spi_sends_from_a_sketch(libraries: Path, tmp_path: Path) -> None:
    sketch = sketch_of(tmp_path, SPI, DAC_ON_THE_SPI)
    assert prints(build(libraries, sketch, BOARDS["atmega328p"], tmp_path / "build"), "atmega328p") == ["1", "0", "1"]


def test_the_sketch_is_right_for_a_sensor_whose_zero_is_elsewhere(libraries: Path, tmp_path: Path) -> None:
    params = tmp_path / "params"
    params.mkdir()
    model = json.loads((PARAMS / "model.json").read_text()) | {"offset_um": -3.75}
    (params / "model.json").write_text(json.dumps(model))
    run(sys.executable, "-m", "rdpi", "header", params / "model.json", "-o", params / "rdpi_params.h")
    shutil.copytree(libraries, tmp_path / "libraries")
    shutil.copy(params / "rdpi_params.h", tmp_path / "libraries/rdpi/examples/TrackFixedPoint")
    sketch = tmp_path / "libraries/rdpi/examples/TrackFixedPoint/TrackFixedPoint.ino"
    program = build(tmp_path / "libraries", sketch, BOARDS["atmega2560"], tmp_path / "build")
    status, *said = prints(program, "atmega2560")
    assert status == "status 0"
    codes = host_codes("q31", tmp_path / "host", params=params)
    assert max(abs(int(line) - code) for line, code in zip(said, codes, strict=True)) <= 1  # its double has 32 bits
    assert len(set(codes)) > 100


# Headers in place of those of the IDE. They print each code as the DAC understands it, then "end".
STAND_IN = """
#pragma once
#include <Arduino.h>
static inline void dac_gets(uint8_t first, uint8_t second)
{
    extern uint32_t lost;
    static uint16_t frames;
    Serial.println((first & 0x0F) << 8 | second);
    if (++frames == 900) {
        Serial.println(lost);
        Serial.println("end");
    }
}
"""
WIRE_STAND_IN = STAND_IN + """
struct TwoWire {
    void begin() {}
    void setClock(uint32_t) {}
    void beginTransmission(uint8_t address) { right = address == 0x62; }
    size_t write(const uint8_t *bytes, size_t count)
    {
        right = right && count == 2 && bytes[0] >> 4 == 0 && (SREG & 0x80); /* with interrupts: not in one */
        if (right) {
            dac_gets(bytes[0], bytes[1]);
        }
        return count;
    }
    uint8_t endTransmission() { return right ? 0 : 2; }
    bool right;
};
static TwoWire Wire;
"""
SPI_STAND_IN = STAND_IN + """
#define SPI_MODE0 0
struct SPISettings {
    SPISettings(uint32_t, uint8_t, uint8_t) {}
};
struct SPIClass {
    void begin() {}
    void beginTransaction(SPISettings) { count = 0; }
    void endTransaction() {}
    void transfer(uint8_t byte)
    {
        if (count++ == 0) {
            first = byte;
        } else if (first >> 4 == 3) { /* channel A, gain 1, on */
            dac_gets(first, byte);
        }
    }
    uint8_t first, count;
};
static SPIClass SPI;
"""
DRIVES = {"DriveMCP4725": ("Wire", WIRE_STAND_IN), "DriveMCP4922": ("SPI", SPI_STAND_IN)}


def real_sensor(folder: Path, **drive: object) -> Path:
    """A model with a sensor whose zero is elsewhere, and effects that a chain compensates, with its header."""
    model = json.loads((PARAMS / "model.json").read_text())
    model["offset_um"] = -3.75
    model["drive"].update(dac_bits=12, **drive)
    model["effects"] = [{"name": "creep", "stage": "actuator", "parameters": {"percent_per_decade": 3.0}},
                        {"name": "delay", "stage": "sensor", "parameters": {"delay_s": 0.01}}]
    folder.mkdir()
    (folder / "model.json").write_text(json.dumps(model))
    run(sys.executable, "-m", "rdpi", "header", folder / "model.json", "-o", folder / "rdpi_params.h")
    header = (folder / "rdpi_params.h").read_text()
    assert "#define RDPI_PARAMS_CHAIN 1" in header and "(um) - (-3.75)" in header
    return folder


@pytest.mark.parametrize("name", DRIVES)
def test_a_sketch_drives_its_dac_from_a_timer(libraries: Path, tmp_path: Path, name: str) -> None:
    """The sketch as it is shipped, with another header: sweep, ramp, then the codes of `rdpi compensate`, no tick lost."""
    library, stand_in = DRIVES[name]
    chip = "atmega2560"
    params = real_sensor(tmp_path / "params")
    shutil.copytree(libraries, tmp_path / "libraries")
    (tmp_path / "stand_ins").mkdir()
    (tmp_path / f"stand_ins/{library}.h").write_text(stand_in)
    sketch = tmp_path / f"libraries/rdpi/examples/{name}/{name}.ino"
    shutil.copy(params / "rdpi_params.h", sketch.parent)
    said = prints(build(tmp_path / "libraries", sketch, BOARDS[chip], tmp_path / "build", tmp_path / "stand_ins"), chip)
    assert "status 0" in said
    *codes, lost = [int(line) for line in said if line.isdigit()]
    assert lost == 0
    assert abs(codes[0] - 20 / 140 * 4095) <= 1 and min(codes) == 0 and max(codes) == 4095  # safe code; the sweep
    assert np.abs(np.diff(codes)).max() <= 5600 / 400 / 140 * 4095 + 1  # never faster than the sweep
    height = 160 - np.abs(np.arange(400) % 320 - 160)
    rows = (f"{k / 400!r},{0.05 * um!r}" for k, um in enumerate(height.tolist()))
    (tmp_path / "reference.csv").write_text("\n".join(["time_s,reference_um", *rows, ""]))
    run(sys.executable, "-m", "rdpi", "compensate", "--sweep", "--engine", "q31", params / "model.json",
        tmp_path / "reference.csv", "-o", tmp_path / "drive.csv")
    with (tmp_path / "drive.csv").open() as file:
        expected = [int(row["dac_code"]) for row in csv.DictReader(line for line in file if not line.startswith("#"))]
    assert np.ptp(expected) > 1000
    # The host goes from the sweep to the reference in one step, the sketch by a ramp, and its double has 32 bits.
    errors = [np.abs(np.subtract(codes[k:k + 320], expected[:320])).max() for k in range(100, len(codes) - 320)]
    assert min(errors) <= 8


def test_a_dac_that_does_not_answer_starts_no_timer(libraries: Path, tmp_path: Path) -> None:
    shutil.copytree(libraries, tmp_path / "libraries")
    (tmp_path / "stand_ins").mkdir()
    dead = WIRE_STAND_IN.replace("return right ? 0 : 2;", 'static uint8_t calls; if (++calls == 10) { Serial.println("ten"); } '
                                 "return 2;")
    (tmp_path / "stand_ins/Wire.h").write_text(dead)
    sketch = tmp_path / "libraries/rdpi/examples/DriveMCP4725/DriveMCP4725.ino"
    sketch.write_text(sketch.read_text().replace("void loop()\n{", 'void loop()\n{\n    Serial.println(TIMSK1);\n    '
                                                 'Serial.println("end");\n', 1))
    said = prints(build(tmp_path / "libraries", sketch, BOARDS["atmega2560"], tmp_path / "build", tmp_path / "stand_ins"), "atmega2560")
    assert said.count("ten") == 1 and "no DAC answers" in said and said[-1] == "0"


def test_the_library_tells_the_ide_what_it_asks_for(package: ModuleType, libraries: Path) -> None:
    properties = dict(line.split("=", 1) for line in (libraries / "rdpi/library.properties").read_text().splitlines())
    assert {"name", "version", "author", "maintainer", "sentence", "paragraph", "category", "url",
            "architectures"} <= set(properties)
    assert properties["version"] == package.version()
    assert (libraries / "rdpi/src" / properties["includes"]).is_file()
