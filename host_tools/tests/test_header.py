"""The generated C header: it compiles everywhere, holds the model to the last bit of a float and names its origin."""

from __future__ import annotations

import ctypes
import re
import shutil
import struct
import subprocess
import zlib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from models import random_model
from written import sections_as_read

from rdpi import firmware, version
from rdpi.firmware._f32 import lib
from rdpi.errors import BadInput
from rdpi.firmware import FixedPoint, parameters
from rdpi.firmware.header import (CHAIN_SCALARS, Q31_CHAIN_SCALARS, Q31_SCALARS, Q31_TABLES, SCALARS, SCHEMA, TABLES,
                                  _check_name, comment, literal, render, write_header)
from rdpi.model import Drive, Memory, Model, Rate, operators, read_model, write_model

ROOT = Path(__file__).resolve().parents[2]
STRICT_C = "cc -x c -std=c99 -Wall -Wextra -Wconversion -Wdouble-promotion -Wshadow -Wpedantic -Werror".split()
STRICT_CXX = "c++ -x c++ -std=c++11 -Wall -Wextra -Wconversion -Wpedantic -Werror".split()
DIGESTS = ["sha256:" + "ab" * 32, "sha256:" + "cd" * 32]
HOSTILE = "evil */ #error out ??/ /* \\\n\r\t\x00\x1b µm ♥ \u2028 // \"quoted\" %s {{ name }} ??'"


@pytest.fixture
def model() -> Model:
    """Numbers that no float holds exactly, four plays, two dead zones."""
    return Model(
        gain_um_per_V=-0.1, offset_V=100.1, offset_um=-0.7, stroke_um=12.3,
        thresholds_um=np.array([0, 0.1, 1.3, 4.7]), slopes=np.array([0.3, 0.7, 0.9, 1.1]),
        slope_rate_s_per_um=np.array([-1e-4, -3.3e-7, -0.0, 1e-9]), deadzones_um=np.array([0, 1 / 3]),
        deadzone_weights=np.array([1.1, -0.2]), rate=Rate("displacement", 1.6e-3, 3e-4, 1234.5, 3000.0, 0.2),
        drive=Drive(-20.2, 120.3, 1e5, 16), memory=Memory(0.2, np.array([0.2, 0.1, -0.3, 0.0])), actuator="P-885.91",
        fit={"runs": [
            {"file": "/home/someone/fit.csv", "digest": DIGESTS[0], "rms_percent": 0.1234, "max_percent": 1.5},
            {"file": "C:\\someone\\held.csv", "digest": DIGESTS[1], "held_out": True, "rms_percent": 0.5}]})


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess]:
    """Compile `main_c` with headers {name: text} beside it and, if that works, run it; compiler flags may be added."""

    def run(main_c: str, headers: dict[str, str], *flags: str,
            compiler: list[str] = STRICT_C) -> subprocess.CompletedProcess:
        for name, text in headers.items():
            (tmp_path / name).write_text(text, encoding="ascii")
        (tmp_path / "main.c").write_text(main_c)
        sources = sorted((ROOT / "lib/src").glob("*.c"))
        objects = [tmp_path / f"{source.stem}.o" for source in sources]
        flags = ("-I", str(ROOT / "lib/include"), *flags)
        for source, target in zip(sources, objects):
            subprocess.run(["cc", "-std=c99", *flags, "-c", source, "-o", target], check=True)
        command = [*compiler, *flags, "main.c", "-x", "none", *objects, "-lm", "-o", "program"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        return done if done.returncode else subprocess.run([tmp_path / "program"], capture_output=True, text=True)

    return run


def test_the_header_carries_the_range_of_sample_times(model: Model, compiled: Callable) -> None:
    """A range of 140 V that is swept at 5600 V/s: eight samples per ramp are 3.125 ms and 17.5 V each."""
    model.drive = replace(model.drive, min_V=-20.0, max_V=120.0, sweep_V_per_s=5600.0, slew_V_per_s=None)
    model.rate = replace(model.rate, window_s=0.0)
    done = compiled("""
        #include <stdio.h>
        #include "rdpi_params.h"
        int main(void)
        {
            static const float f32[] = {3.125e-3f, 3.13e-3f, 0.1f, 10.0f, 0.5e-6f, 0.49e-6f, 0.0f};
            static const uint32_t q31[] = {3125000, 3125001, 100000000, 500, 499, 100, 0};
            static rdpi_f32_t single;
            static rdpi_q31_t fixed;
            for (int i = 0; i < 7; i++) {
                printf("%d %d ", (int)rdpi_f32_init(&single, &rdpi_params, f32[i]),
                       (int)rdpi_q31_init(&fixed, &rdpi_params_q31, q31[i]));
            }
            printf("%g %g %g", RDPI_PARAMS_MIN_SAMPLE_TIME_S, RDPI_PARAMS_MAX_SAMPLE_TIME_S, RDPI_PARAMS_MAX_SWEEP_STEP_V);
            return 0;
        }""", {"rdpi_params.h": render(model)})
    words = done.stdout.split()
    assert words[:14:2] == ["0", "-21", "-21", "-21", "0", "-21", "-11"], done.stderr
    assert words[1:14:2] == ["0", "-21", "-21", "0", "-21", "-21", "-11"]
    assert words[14:] == ["5e-07", "0.003125", "17.5"]


def test_a_library_built_for_any_sample_time_takes_any(model: Model, compiled: Callable) -> None:
    model.drive = replace(model.drive, sweep_V_per_s=None, slew_V_per_s=None)
    for main in (INIT.replace("1e-4f", "0.1f"), INIT_Q31.replace("100000u", "100000000u")):
        assert compiled(main, {"rdpi_params.h": render(model)}).returncode == 21
        assert compiled(main, {"rdpi_params.h": render(model)}, "-DRDPI_ANY_SAMPLE_TIME=1").returncode == 0


def test_firmware_can_read_what_the_header_is_of(model: Model, compiled: Callable) -> None:
    model.actuator = 'stack "A" ??/ \\ 100 % µm'
    done = compiled("""
        #include <stdio.h>
        #include "rdpi_params.h"
        int main(void)
        {
            puts(RDPI_PARAMS_ACTUATOR);
            puts(RDPI_PARAMS_MODEL);
            puts(RDPI_PARAMS_TOOL);
            puts(RDPI_VERSION);
            return 0;
        }""", {"rdpi_params.h": render(model)})
    assert done.stdout.splitlines() == ["stack _A_ __/ _ 100 % um", model.digest(), version(), version()], done.stderr


def test_the_library_has_one_version() -> None:
    numbers = re.findall(r"#define RDPI_VERSION_(?:MAJOR|MINOR|PATCH) (\d+)",
                         (ROOT / "lib/include/rdpi/types.h").read_text())
    [project] = re.findall(r"project\(rdpi VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())
    [text] = re.findall(r'#define RDPI_VERSION "(.*)"', (ROOT / "lib/include/rdpi/types.h").read_text())
    assert ".".join(numbers) == text == project


INIT = """
#include "rdpi_params.h"
int main(void)
{
    static rdpi_f32_t axis;
    return -(int)rdpi_f32_init(&axis, &rdpi_params, 1e-4f);
}
"""
INIT_Q31 = """
#include "rdpi_params.h"
int main(void)
{
    static rdpi_q31_t axis;
    return RDPI_PARAMS_Q31 == 1 ? -(int)rdpi_q31_init(&axis, &rdpi_params_q31, 100000u) : 99;
}
"""


def edited(model: Model, key: str, value: object) -> Model:
    """A copy with one key of the model file changed."""
    section, _, field = key.rpartition(".")
    if section:
        return replace(model, **{section: replace(getattr(model, section), **{field: value})})
    return replace(model, **{key: value})


def bits(values: np.ndarray | float) -> list[int]:
    return np.atleast_1d(np.asarray(values, np.float32)).view(np.uint32).tolist()


def test_the_same_model_gives_the_same_bytes(model: Model, tmp_path: Path) -> None:
    first, second = tmp_path / "first.h", tmp_path / "second.h"
    write_header(model, first, source="somewhere/model.json")
    with sections_as_read():
        write_model(tmp_path / "model.json", model)
    write_header(read_model(tmp_path / "model.json"), second, source=str(tmp_path / "model.json"))
    assert first.read_bytes() == second.read_bytes()


def test_the_banner_names_the_origin_and_neither_time_nor_place(model: Model) -> None:
    text = render(model, source="/home/someone/model.json")
    banner = text[:text.index("*/")]
    for part in ("from model.json.", "Actuator: P-885.91", f"Model: {model.digest()}",
                 "Fitted to: fit.csv, rms 0.123 %, max 1.5 % of stroke", DIGESTS[0],
                 "Held out: held.csv, rms 0.5 % of stroke", DIGESTS[1]):
        assert part in banner
    assert "someone" not in text
    assert not re.search(r"\d{4}-\d\d|\d\d:\d\d", text.replace("sha256:", ""))
    assert "control" not in text
    assert "control" in render(edited(model, "rate.source", "control"))


@pytest.mark.parametrize("fit", [{"runs": 3}, {"runs": ["a.csv", None, {}]}, {"runs": [{"rms_percent": "low"}]},
                                 {"runs": [{"rms_percent": 10**400, "max_percent": float("nan")}]}])
def test_an_odd_fit_section_does_no_harm(model: Model, fit: dict) -> None:
    assert "static const rdpi_f32_params_t rdpi_params" in render(replace(model, fit=fit))


@pytest.mark.parametrize("main", [INIT, INIT_Q31], ids=["f32", "q31"])
@pytest.mark.parametrize("compiler", [STRICT_C, STRICT_CXX], ids=["C99", "C++11"])
def test_it_compiles_without_warnings_and_init_takes_it(model: Model, compiled: Callable, compiler: list[str],
                                                        main: str) -> None:
    model.fit["runs"][0] |= {"file": HOSTILE, "digest": HOSTILE}
    header = render(replace(model, actuator=HOSTILE), source=HOSTILE)
    done = compiled(main, {"rdpi_params.h": header}, compiler=compiler)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_compiler_reads_every_value_back_to_the_bit(model: Model, compiled: Callable) -> None:
    single = parameters.f32(model)
    tables = {field: getattr(single, field) for field in TABLES}
    prints = "".join(f"print({values.size}, (const rdpi_real_t *)rdpi_params.{field});"
                     for field, values in tables.items())
    numbers = "".join(f"print(1, &rdpi_params.{field});" for field in SCALARS)
    done = compiled(f"""
        #include <stdio.h>
        #include <string.h>
        #include "rdpi_params.h"
        static void print(int count, const rdpi_real_t *values)
        {{
            for (int i = 0; i < count; i++) {{
                uint32_t pattern;
                memcpy(&pattern, &values[i], sizeof pattern);
                printf("%lu ", (unsigned long)pattern);
            }}
        }}
        int main(void)
        {{
            printf("%lu %lu %d %d %d %d ", (unsigned long)rdpi_params.schema, (unsigned long)rdpi_params.digest,
                   rdpi_params.plays, rdpi_params.deadzones, rdpi_params.dac_bits, rdpi_params.sweep_cycles);
            {prints} {numbers}
            return 0;
        }}""", {"rdpi_params.h": render(model)})
    expected = [SCHEMA, firmware.digest(single), len(model.slopes), len(model.deadzones_um), model.drive.dac_bits, 20]
    for values in (*tables.values(), *(getattr(single, field) for field in SCALARS)):
        expected += bits(np.ravel(values))
    assert [int(word) for word in done.stdout.split()] == expected, done.stderr


def test_the_compiler_reads_every_integer_back(model: Model, compiled: Callable) -> None:
    q31 = parameters.q31(model)
    tables = {field: getattr(q31, field) for field in Q31_TABLES}
    prints = "".join(f"print({values.size}, (const int32_t *)rdpi_params_q31.{field});"
                     for field, values in tables.items())
    numbers = "".join('printf("%lld ", (long long)rdpi_params_q31.' + f"{field});" for field in Q31_SCALARS)
    done = compiled(f"""
        #include <stdio.h>
        #include "rdpi_params.h"
        static void print(int count, const int32_t *values)
        {{
            for (int i = 0; i < count; i++) {{
                printf("%ld ", (long)values[i]);
            }}
        }}
        int main(void)
        {{
            printf("%lu %lu ", (unsigned long)rdpi_params_q31.schema, (unsigned long)rdpi_params_q31.digest);
            {numbers} {prints}
            return 0;
        }}""", {"rdpi_params.h": render(model)})
    expected = [SCHEMA, firmware.digest(q31), *(getattr(q31, field) for field in Q31_SCALARS)]
    for values in tables.values():
        expected += np.ravel(values).tolist()
    assert [int(word) for word in done.stdout.split()] == expected, done.stderr


@pytest.mark.parametrize("offset_um", [-30.0, 0.0, 12.5])
@pytest.mark.parametrize(("compiler", "constant"), [(STRICT_C, "static const"), (STRICT_CXX, "constexpr")])
def test_a_difference_has_no_offset(model: Model, compiled: Callable, compiler: list[str], constant: str,
                                    offset_um: float) -> None:
    model = replace(model, offset_um=offset_um)
    per_um = 1 / FixedPoint(model, 1e-3).parameters.scale.um_per_reference
    done = compiled(f"""
        #include <stdio.h>
        #include "rdpi_params.h"
        {constant} int32_t steps[] = {{RDPI_PARAMS_Q31_DIFFERENCE(0.05), RDPI_PARAMS_Q31_DIFFERENCE(-0.05),
                                       RDPI_PARAMS_Q31_DIFFERENCE(0), RDPI_PARAMS_Q31_DIFFERENCE(1.5f)}};
        int main(void)
        {{
            printf("%ld %ld %ld %ld", (long)steps[0], (long)steps[1], (long)steps[2], (long)steps[3]);
            return 0;
        }}""", {"rdpi_params.h": render(model)}, compiler=compiler)
    assert [int(word) for word in done.stdout.split()] == [round(um * per_um) for um in (0.05, -0.05, 0, 1.5)], done.stderr


SENSORS = {"12 bits": (0.01, -20.0, 0, 4095), "falling": (-0.003, 18.5, 0, 16383), "24 bits": (5e-6, -40.0, 0, 2**24 - 1),
           "32 bits": (1e-8, 0.0, -(2**31), 2**31 - 1), "far zero": (0.002, 5000.0, -2_510_000, -2_490_000)}


@pytest.mark.parametrize("offset_um", [-3.0, 0.0, 12.5])
@pytest.mark.parametrize(("um_per_count", "um_at_0", "low", "high"), SENSORS.values(), ids=SENSORS)
@pytest.mark.parametrize(("compiler", "constant"), [(STRICT_C, "static const"), (STRICT_CXX, "constexpr")])
def test_counts_become_references_in_integers(model: Model, compiled: Callable, compiler: list[str], constant: str,
                                              um_per_count: float, um_at_0: float, low: int, high: int,
                                              offset_um: float) -> None:
    model = replace(model, offset_um=offset_um)
    unit = Fraction(FixedPoint(model, 1e-3).parameters.scale.um_per_reference)
    counts = [*np.linspace(low, high, 301).astype(int).tolist(), -(2**31), 2**31 - 1]
    done = compiled(f"""
        #include <stdio.h>
        #include "rdpi_params.h"
        {constant} rdpi_q31_sensor_t sensor = RDPI_PARAMS_Q31_SENSOR({um_per_count!r}, {um_at_0!r});
        {constant} int32_t counts[] = {{{", ".join(f"(int32_t){count}LL" for count in counts)}}};
        int main(void)
        {{
            for (unsigned i = 0; i < sizeof counts / sizeof *counts; i++) {{
                printf("%ld ", (long)rdpi_q31_of_counts(&sensor, counts[i]));
            }}
            return 0;
        }}""", {"rdpi_params.h": render(model)}, compiler=compiler)
    found = [int(word) for word in done.stdout.split()]
    assert len(found) == len(counts), done.stderr
    within = 0
    for count, reference in zip(counts, found):
        count = min(max(count, -2147483520), 2147483520)  # the counts of 32 bits that a float holds, too
        exact = (Fraction(um_per_count) * count + Fraction(um_at_0) - Fraction(offset_um)) / unit
        if abs(exact) <= 3 * 2**29:
            within += 1
            assert abs(reference - exact) <= 0.75
        else:  # held at the end of the actuator's reach and more
            assert 3 * 2**29 - 2**29 <= abs(reference) < 2**31 and (reference > 0) == (exact > 0)
    assert within > 30


@pytest.mark.parametrize(("compiler", "constant"), [(STRICT_C, "static const"), (STRICT_CXX, "constexpr")])
def test_conversions_are_constant_expressions(model: Model, compiled: Callable, compiler: list[str],
                                              constant: str) -> None:
    fixed = FixedPoint(model, 1e-4)
    wanted_um = [-0.7, -0.7000001, 3.3, -5.1, 7]
    scale = fixed.parameters.scale
    macros = ", ".join(f"RDPI_PARAMS_Q31_REFERENCE({um!r})" for um in (*wanted_um, "1.5f"))
    done = compiled(f"""
        #include <stdio.h>
        #include "rdpi_params.h"
        {constant} int32_t references[] = {{{macros}}};
        {constant} double others[] = {{RDPI_PARAMS_Q31_VOLT(1000), RDPI_PARAMS_Q31_UM(-3)}};
        {constant} double rate = RDPI_PARAMS_Q31_UM_PER_S(RDPI_Q31_ONE / 4);
        {constant} int32_t back[] = {{
            RDPI_PARAMS_Q31_DRIVE(RDPI_PARAMS_Q31_VOLT(1000)), RDPI_PARAMS_Q31_DRIVE(RDPI_PARAMS_Q31_VOLT(-1001)),
            RDPI_PARAMS_Q31_DRIVE(RDPI_PARAMS_Q31_VOLT(7.4)), RDPI_PARAMS_Q31_DRIVE(RDPI_PARAMS_Q31_VOLT(-7.6)),
            RDPI_PARAMS_Q31_RATE(RDPI_PARAMS_Q31_UM_PER_S(12345))}};
        int main(void)
        {{
            for (int i = 0; i < 6; i++) {{
                printf("%ld ", (long)references[i]);
            }}
            printf("%.17g %.17g %.17g", others[0], others[1], rate);
            for (int i = 0; i < 5; i++) {{
                printf(" %ld", (long)back[i]);
            }}
            return 0;
        }}""".replace("'1.5f'", "1.5f"), {"rdpi_params.h": render(model)}, compiler=compiler)
    words = done.stdout.split()
    assert [int(word) for word in words[:6]] == fixed.references([*wanted_um, 1.5]).tolist(), done.stderr
    assert float(words[6]) == pytest.approx(scale.offset_V + 1000 * scale.V_per_drive, rel=1e-15)
    assert float(words[7]) == pytest.approx(scale.offset_um - 3 * scale.um_per_reference, rel=1e-15)
    assert float(words[8]) == pytest.approx(model.rate.max_um_per_s / 4, rel=1e-15)
    assert [int(word) for word in words[9:]] == [1000, -1001, 7, -8, 12345]


def test_a_model_beyond_fixed_point_has_floats_alone_and_says_why(model: Model, compiled: Callable) -> None:
    steep = replace(model, slopes=np.array([0.01, 0.7, 0.9, 1.1]), slope_rate_s_per_um=np.zeros(4))
    text = render(steep)
    assert "rdpi_q31" not in text and "#define RDPI_PARAMS_Q31 0" in text
    assert "No:\n * slopes: at rest or at the guard they span 0.01 to 1.1, more than 1 : 64; raise" in text
    assert max(map(len, text.splitlines())) <= 120
    main = "#if RDPI_PARAMS_Q31\n#error fixed point\n#endif\n"
    done = compiled(INIT.replace("int main", main + "int main"), {"rdpi_params.h": text})
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("gain", [-0.1, 0.1])
def test_a_bent_input_curve_is_a_table(model: Model, compiled: Callable, gain: float) -> None:
    points = ((-20.2, -20.2), *((10.0 * k, 10 * k + 0.002 * k**3) for k in range(4, 11)), (120.3, 123.0))
    model = replace(model, gain_um_per_V=gain, offset_V=50.1, drive=replace(model.drive, curve_V=points))
    text = render(model)
    assert "#define RDPI_PARAMS_CURVE_PIECES 8" in text and max(map(len, text.splitlines())) <= 120
    for main in (INIT, INIT_Q31):
        done = compiled(main, {"rdpi_params.h": text})
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    done = compiled(INIT, {"rdpi_params.h": text}, "-DRDPI_MAX_CURVE_PIECES=7")
    assert done.returncode == 1 and "define RDPI_MAX_CURVE_PIECES as 8 or more" in done.stderr


def test_a_straight_input_curve_fits_a_library_without_the_curve(model: Model, compiled: Callable) -> None:
    for main in (INIT, INIT_Q31):
        done = compiled(main, {"rdpi_params.h": render(model)}, "-DRDPI_MAX_CURVE_PIECES=1")
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("seed", range(5))
def test_the_digest_is_the_crc_of_the_fields_in_their_order(seed: int) -> None:
    single = parameters.f32(random_model(seed, plays=seed, deadzones=seed % 3))
    data = struct.pack("<H4BH15f", single.plays, single.deadzones, single.dac_bits, single.curve_pieces,
                       single.noise_shaping, single.sweep_cycles, *(getattr(single, field) for field in SCALARS))
    data += b"".join(getattr(single, field).astype("<f4").tobytes() for field in TABLES)
    assert firmware.digest(single) == zlib.crc32(data)


def test_what_follows_from_other_fields_follows_from_them_as_rounded(model: Model) -> None:
    """By other formulas than parameters.py uses: P_i from the loading curve's corners, S^-1 by putting S into it."""
    single = parameters.f32(model)
    r, slopes, slope_rates, intercept, intercept_rate = single.play.T.astype(float)
    assert bits(r) == bits(model.thresholds_um) and bits(slopes) == bits(model.slopes)
    for values, theirs in ((slopes, intercept), (slope_rates, intercept_rate)):
        at_corner = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(r))])  # the curve at r_i
        np.testing.assert_allclose(theirs, values * r - at_corner, rtol=1e-6, atol=1e-7 * np.abs(values).max())
    for gain in np.random.default_rng(1).normal(size=50):
        numbers = parameters.f32(replace(model, gain_um_per_V=gain))
        assert numbers.curve[0, 5] == np.float32(1 / float(np.float32(gain)))
    v = np.linspace(-3, 9, 50)
    z = operators.saturation(v, *single.saturation.T.astype(float))
    low, high, slope, intercept = single.inverse_saturation.T.astype(float)
    assert low[0] == -parameters.MAX_REFERENCE_UM and high[-1] == parameters.MAX_REFERENCE_UM
    assert low[1:].tolist() == high[:-1].tolist()
    piece = np.searchsorted(high[:-1], z + single.offset_um)
    np.testing.assert_allclose(slope[piece] * z + intercept[piece], v, atol=2e-6)
    numbers = parameters.f32(replace(model, drive=replace(model.drive, dac_bits=16)))
    code = np.arange(0, 2**16, 1001)
    codes_per_um, code_of_x_0, um_per_code, x_of_code_0_um = numbers.curve[0, 9:].astype(float)
    x_um = um_per_code * code + x_of_code_0_um
    volt = numbers.V_per_code * code + numbers.min_V
    np.testing.assert_allclose(x_um, model.x_of(volt), rtol=0, atol=5e-6)
    np.testing.assert_allclose(codes_per_um * x_um + code_of_x_0, code + 0.5, atol=0.02)
    assert numbers.last_code == 2**16 - 1
    last_V = numbers.min_V + numbers.last_code * numbers.V_per_code
    assert last_V <= numbers.max_V and last_V == pytest.approx(numbers.max_V, rel=1e-6)
    assert (single.sweep_end_V, single.sweep_cycles) == (pytest.approx(98.1), 20)
    assert single.sweep_V_per_s == pytest.approx(2 * 140.5 * 20)


def test_the_compiler_reads_literals_of_every_magnitude_back(compiled: Callable) -> None:
    patterns = np.random.default_rng(1).integers(0, 2**32, 3000, dtype=np.uint32).view(np.float32)
    edges = np.array([0.0, -0.0, 3.3e-7, 1e-45, 1.17549435e-38, 3.40282347e38, -3.40282347e38, 1.0, 16777217.0, 0.1])
    values = [*edges, *(float(value) for value in patterns[np.isfinite(patterns)])]
    main = ("#include <stdio.h>\n#include <string.h>\nint main(void) { static const float v[] = {"
            + ", ".join(map(literal, values)) + "}; for (size_t i = 0; i < sizeof v / sizeof v[0]; i++) {"
            "unsigned p; memcpy(&p, &v[i], sizeof p); printf(\"%u \", p); } return 0; }")
    assert [int(word) for word in compiled(main, {}).stdout.split()] == bits(np.array(values))


@given(st.floats(-3.4e38, 3.4e38))
def test_literals_are_floats_that_read_back_to_the_bit(value: float) -> None:
    text = literal(value)
    assert re.fullmatch(r"-?\d+\.\d*(e[+-]\d+)?f", text)
    strtof = ctypes.CDLL(None).strtof
    strtof.restype, strtof.argtypes = ctypes.c_float, [ctypes.c_char_p, ctypes.c_void_p]
    assert bits(strtof(text.removesuffix("f").encode(), None)) == bits(value)


@given(st.text() | st.text("*/\\?%\n\" µ"))
def test_no_text_gets_out_of_a_comment(text: str) -> None:
    safe = comment(text)
    assert safe.isascii() and safe.isprintable() and len(safe) <= 100
    assert not set(safe) & set("*?\\\"")


def test_comments_stay_readable() -> None:
    assert comment("  piézo,\n12.5 µm/s ") == "piezo, 12.5 um/s"


def test_a_library_of_another_schema_is_an_error(model: Model, compiled: Callable) -> None:
    assert SCHEMA == lib.RDPI_PARAMS_SCHEMA
    other = '#include "rdpi/rdpi.h"\n#undef RDPI_PARAMS_SCHEMA\n#define RDPI_PARAMS_SCHEMA 99u\n'
    done = compiled(other + INIT, {"rdpi_params.h": render(model)})
    assert done.returncode == 1 and f"these parameters have schema {SCHEMA}" in done.stderr


@pytest.mark.parametrize("flag", ["RDPI_MAX_PLAYS=3", "RDPI_MAX_DEADZONES=1"])
def test_a_library_that_is_too_small_is_an_error(model: Model, compiled: Callable, flag: str) -> None:
    done = compiled(INIT, {"rdpi_params.h": render(model)}, f"-D{flag}")
    name, size = flag.split("=")
    assert done.returncode == 1 and f"define {name} as {int(size) + 1} or more" in done.stderr
    assert compiled(INIT, {"rdpi_params.h": render(model)}, f"-D{name}={int(size) + 1}").returncode == 0


AROUND = firmware.Chain(1.1e-3, 5.7e-4, 3.3e-4, 1.7e-7, 0.7, False, 0.9, ((0.07, 4e-3), (-0.01, 0.3), (0.03, 1000.0)))
INIT_CHAIN = """
#include <stdio.h>
#include "rdpi_params.h"
int main(void)
{
    static rdpi_f32_chain_t axis;
    static rdpi_q31_chain_t axis_q31;
    int wrong = -(int)rdpi_f32_chain_init(&axis, &rdpi_chain, 1e-4f);
    wrong += -(int)rdpi_q31_chain_init(&axis_q31, &rdpi_chain_q31, 100000u);
    printf("%d %lu %lu\\n", RDPI_PARAMS_CHAIN, (unsigned long)axis.preview_samples, (unsigned long)rdpi_chain.poles);
    return wrong;
}
"""


@pytest.mark.parametrize(("chain", "printed"), [
    (AROUND, "1 0 3"), (replace(AROUND, preview=True), "1 13 3"), (firmware.Chain(), "0 0 0")])
@pytest.mark.parametrize("compiler", [STRICT_C, STRICT_CXX], ids=["C99", "C++11"])
def test_a_chain_compiles_without_warnings_and_init_takes_it(model: Model, compiled: Callable, compiler: list[str],
                                                             chain: firmware.Chain, printed: str) -> None:
    done = compiled(INIT_CHAIN, {"rdpi_params.h": render(model, chain=chain)}, compiler=compiler)
    assert (done.returncode, done.stderr, done.stdout.strip()) == (0, "", printed)


def test_the_compiler_reads_the_numbers_of_a_chain_back(model: Model, compiled: Callable) -> None:
    single = firmware.Firmware(model, 1e-3, "f32", AROUND).chain
    integers = FixedPoint(model, 1e-3, AROUND).chain
    fields = list(CHAIN_SCALARS)[2:]
    done = compiled("""
        #include <stdio.h>
        #include <string.h>
        #include "rdpi_params.h"
        static void bits(float value)
        {
            unsigned int word;
            memcpy(&word, &value, sizeof word);
            printf("%u ", word);
        }
        int main(void)
        {
            """ + " ".join(f"bits(rdpi_chain.{name});" for name in fields) + """
            for (int i = 0; i < 3; i++) { bits(rdpi_chain_pole[i].share); bits(rdpi_chain_pole[i].time_constant_s); }
            """ + " ".join(f'printf("%lld ", (long long)rdpi_chain_q31.{name});' for name in Q31_CHAIN_SCALARS) + """
            for (int i = 0; i < 3; i++) {
                printf("%d ", (int)rdpi_chain_q31_pole[i].share);
                printf("%lld ", (long long)rdpi_chain_q31_pole[i].time_constant_ns);
            }
            return 0;
        }""", {"rdpi_params.h": render(model, chain=AROUND)})
    expected = [*bits(np.array([getattr(single, name) for name in fields])), *bits(single.pole.ravel()),
                *(getattr(integers, name) for name in Q31_CHAIN_SCALARS), *np.ravel(integers.pole)]
    assert done.stderr == "" and [int(word) for word in done.stdout.split()] == expected


def test_a_changed_number_of_a_chain_is_an_error(model: Model, compiled: Callable) -> None:
    text = render(model, chain=AROUND)
    for old, new in (("1000000000000ull}", "1000000000001ull}"), (f"{literal(0.07)},", f"{literal(0.08)},")):
        assert text.count(old) == 1
        assert compiled(INIT_CHAIN, {"rdpi_params.h": text.replace(old, new)}).returncode == -lib.RDPI_ERR_DIGEST


def test_a_library_with_too_few_poles_is_an_error(model: Model, compiled: Callable) -> None:
    done = compiled(INIT_CHAIN, {"rdpi_params.h": render(model, chain=AROUND)}, "-DRDPI_MAX_POLES=2")
    assert done.returncode == 1 and "define RDPI_MAX_POLES as 3 or more" in done.stderr


def test_addends_are_macros(model: Model, compiled: Callable) -> None:
    text = render(model, addends=[("other_axis_V", -0.25, False), ("temperature_degC", 0.5, True)])
    assert "`value` is that of the recordings' column other_axis_V." in text
    assert "`value` is what the recordings' column temperature_degC has changed since the start." in text
    done = compiled('#include <stdio.h>\n#include "rdpi_params.h"\nint main(void) { printf("%g %g", '
                    "RDPI_PARAMS_OTHER_AXIS_V_UM(2 + 2), RDPI_PARAMS_TEMPERATURE_DEGC_UM(3)); return 0; }",
                    {"rdpi_params.h": text})
    assert (done.stdout, done.stderr) == ("-1 1.5", "")


def test_addends_of_one_name_in_c_are_refused(model: Model) -> None:
    with pytest.raises(BadInput, match="columns axis-b_V and axis_b_V: are the same name in C, AXIS_B_V"):
        render(model, addends=[("axis-b_V", 0.1, False), ("axis_b_V", 0.2, False)])


def test_backlash_is_two_macros(model: Model, compiled: Callable) -> None:
    text = render(model, jump=(0.25, 0.002))
    done = compiled('#include <stdio.h>\n#include "rdpi_params.h"\nint main(void) { printf("%g %g", '
                    "RDPI_PARAMS_BACKLASH_UM / 2, 1 / RDPI_PARAMS_BACKLASH_S); return 0; }", {"rdpi_params.h": text})
    assert (done.stdout, done.stderr) == ("0.125 500", "") and "BACKLASH" not in render(model)


def test_an_array_that_lost_a_value_is_an_error(model: Model, compiled: Callable) -> None:
    text = render(model)
    shorter = re.sub(rf"    {{.* {literal(model.slopes[1])}, .*\n", "", text, count=1)
    assert shorter != text
    done = compiled(INIT, {"rdpi_params.h": shorter})
    assert done.returncode == 1 and "rdpi_params_play_check" in done.stderr


def test_a_number_that_was_changed_is_an_error(model: Model, compiled: Callable) -> None:
    text = render(model)
    rest = str(parameters.q31(model).play[1, 1])
    for main, old, new in ((INIT, literal(model.slopes[2]), literal(model.slopes[2] * 1.001)),
                           (INIT_Q31, rest, rest[:-1] + str((int(rest[-1]) + 1) % 10))):
        assert text.count(old) == 1
        assert compiled(main, {"rdpi_params.h": text.replace(old, new)}).returncode == -lib.RDPI_ERR_DIGEST


def test_two_actuators_in_one_firmware(model: Model, compiled: Callable) -> None:
    other = edited(model, "gain_um_per_V", -0.2)
    done = compiled("""
        #include "x.h"
        #include "y.h"
        int main(void) { return x_axis.curve[0].gain_um_per_V > y_axis.curve[0].gain_um_per_V && X_AXIS_PLAYS == Y_AXIS_PLAYS ? 0 : 1; }
        """, {"x.h": render(model, name="x_axis"), "y.h": render(other, name="y_axis")})
    assert (done.returncode, done.stderr) == (0, "")
    assert "rdpi_params" not in render(model, name="x_axis").replace("rdpi_f32_params_t", "").lower().replace(
        "rdpi_params_schema", "")


def test_a_second_actuator_of_the_same_name_is_an_error_and_not_skipped(model: Model, compiled: Callable) -> None:
    headers = {"x.h": render(model), "y.h": render(edited(model, "gain_um_per_V", -0.2))}
    twice = compiled('#include "x.h"\n#include "y.h"\nint main(void) { return 0; }', headers)
    assert twice.returncode and "another actuator's header of this name" in twice.stderr
    again = compiled('#include "x.h"\n#include "x.h"\nint main(void) { return 0; }', headers)
    assert (again.returncode, again.stderr) == (0, "")


@pytest.mark.parametrize("name", ["", "1x", "a-b", "a b", "_x", "naïve", "x;", "float", "class", "rdpi", "rdpi_max",
                                  "RDPI_MAX", "rdpi_f32_init", "x" * 41, "x\n",
                                  "NULL", "true", "bool", "size_t", "uint32_t", "own_t", "offsetof", "typeof", "asm",
                                  "inline", "linux", "INT8_MAX", "UINT64_C", "INTPTR_MIN", "SIZE_MAX", "WCHAR_MIN"])
def test_names_that_c_cannot_use_are_refused(model: Model, name: str) -> None:
    with pytest.raises(BadInput, match="^name "):
        render(model, name=name)


STANDARD = """assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdarg stdbool
    stddef stdint stdio stdlib string tgmath time wchar wctype""".split()


def includes(compiler: list[str], more: tuple[str, ...] = ()) -> str:
    """Lines that include every header of standard C that a compiler has."""
    lines = [f"#include <{name}.h>\n" for name in (*STANDARD, *more)]
    return "".join(line for line in lines if syntax(compiler, line).returncode == 0)


def syntax(compiler: list[str], source: str) -> subprocess.CompletedProcess:
    return subprocess.run([*compiler, "-fsyntax-only", "-fmax-errors=0", "-I", ROOT / "lib/include", "-"],
                          input=source, capture_output=True, text=True)


@pytest.mark.parametrize("compiler", ["gcc", "arm-none-eabi-gcc"])
@pytest.mark.parametrize("standard", ["c99", "c11"])
def test_names_of_the_standard_headers_are_refused(compiler: str, standard: str) -> None:
    """The compiler is asked which of all words in its headers cannot be the name of parameters."""
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    command = [compiler, "-x", "c", f"-std={standard}", "-w"]
    head = '#include "rdpi/rdpi.h"\n' + includes(command)
    seen = subprocess.run([*command, "-E", "-dD", "-P", "-I", ROOT / "lib/include", "-"], input=head,
                          capture_output=True, text=True, check=True).stdout
    words = sorted(set(re.findall(r"\b[A-Za-z]\w{0,39}\b", re.sub(r'"(\\.|[^"\\])*"', "", seen))))
    words = [word for word in words if not word.lower().startswith("rdpi_")]
    first = head.count("\n") + 1
    told = syntax(command, head + "".join(f"static const rdpi_f32_params_t {word} = {{0}};\n" for word in words)).stderr
    lines = {int(line) for line in re.findall(r"^<stdin>:(\d+):\d+: (?:fatal )?error", told, re.MULTILINE)}
    bad = {words[line - first] for line in lines if line >= first}
    assert {"errno", "EOF", "INFINITY", "FILE", "printf"} <= bad
    assert [word for word in sorted(bad) if not refused_name(word)] == []


def refused_name(name: str) -> bool:
    try:
        _check_name(name)
    except BadInput:
        return True
    return False


KEYWORDS_OF = {  # what no header has; the compiler says that each is one
    "c -std=c99": "auto inline restrict sizeof typedef volatile",
    "c -std=gnu17": "asm typeof linux unix",
    "c++ -std=c++11": "and_eq bitor class compl decltype friend mutable noexcept private template this throw xor",
    "c++ -std=c++20": "char8_t co_await co_yield concept consteval constinit requires",
}


@pytest.mark.parametrize("language", KEYWORDS_OF)
def test_keywords_are_refused(language: str) -> None:
    for word in KEYWORDS_OF[language].split():
        source = f"struct s {{ int a; }};\nstatic struct s {word} = {{0}};\n"
        done = syntax(["gcc", "-x", *language.split()], source)
        assert done.returncode != 0 and "unrecognized" not in done.stderr, f"{word} is no keyword of {language}"
        assert refused_name(word)


@pytest.mark.parametrize("name", ["errno", "EOF", "INFINITY", "M_PI", "FILE", "NULL", "j0", "index", "a__b", "i386",
                                  "nullptr", "constexpr", "typeof_unqual", "alignas", "thread_local"])
def test_names_of_libraries_are_refused(name: str, model: Model) -> None:
    with pytest.raises(BadInput, match="^name "):
        render(model, name=name)


GOOD_NAMES = """x y z x_axis stage piezo actuator left right tip tilt focus mirror fine coarse stack lens axis1 params
    main_axis STAGE P_885_91 model scanner cantilever gain_stage top is_x memory strain""".split()


@pytest.mark.parametrize("compiler", ["gcc -x c", "gcc -x c -std=c99", "gcc -x c++", "arm-none-eabi-gcc -x c"])
def test_plain_names_are_accepted_and_compile(compiler: str, model: Model) -> None:
    """Beside every header of standard C."""
    command = compiler.split()
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]}")
    source = includes(command, ("stdatomic", "threads", "uchar") if "c++" not in compiler else ())
    done = syntax(command, source + "".join(render(model, name=name) for name in GOOD_NAMES))
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.parametrize("key, value, message", [
    ("gain_um_per_V", 1e-40, r": gain_um_per_V: is 1e-40; .* needs a gain, at least"),
    ("slopes", np.array([1e-50, 0.7, 0.9, 1.1]), r": slopes\[0\]: is 1e-50; .* at least 1e-07"),
    ("drive.slew_V_per_s", 1e-46, r": drive.slew_V_per_s: a start-up sweep of 1e-46 V/s is too slow"),
    ("rate.max_um_per_s", 1e-39, r", in the firmware's single precision: rate.max_um_per_s: is 0"),
    ("offset_um", 1e39, r": offset_um: must be finite, within .*as the firmware requires"),
    ("slope_rate_s_per_um", np.array([0, 1e300, 0, 0]), r": slope_rate_s_per_um: must be finite, within"),
    ("thresholds_um", np.array([0, 0.1, 4.7, 4.7 + 1e-9]),
     r", in the firmware's single precision: thresholds_um: must start"),
    ("thresholds_um", np.array([0, 1e-46, 4.7, 5]), r", in the firmware's single precision: thresholds_um: must start"),
    ("deadzones_um", np.array([0, 1e-60]), r", in the firmware's single precision: deadzones_um: must start"),
    ("drive", Drive(100.0, 100.0 + 1e-6, None, 16), r": drive.max_V: a start-up sweep of 4e-05 V/s is too slow"),
    ("drive", Drive(100.0, 100.05, None, 16), r": offset_V: is 100 V, over 1000 times"),
    ("rate.min_slope_ratio", 1 - 1e-9, r", in the firmware's single precision: rate.min_slope_ratio: is 1"),
    ("deadzone_weights", np.array([1, -1 + 1e-12]), r": deadzone_weights: partial sums of 1e-12 to 1 make an inverse"),
    ("deadzone_weights", np.array([1e3, 3e-5 - 1e3]), r", in the firmware's single precision: deadzone_weights: the w"),
])
def test_what_a_float_cannot_hold_is_refused(model: Model, tmp_path: Path, key: str, value: object,
                                             message: str) -> None:
    model = replace(model, slope_rate_s_per_um=np.zeros(4))
    model.memory = Memory(0.0, np.zeros(4))
    if key == "drive":
        model.offset_V = 100.0
    with pytest.raises(BadInput, match="^model.json" + message):
        write_header(edited(model, key, value), tmp_path / "params.h", source="model.json")
    assert list(tmp_path.iterdir()) == []


def test_a_model_that_is_wrong_in_itself_is_refused(model: Model) -> None:
    with pytest.raises(BadInput, match=r"^model: slopes\[3\]"):
        render(edited(model, "slopes", -model.slopes))
