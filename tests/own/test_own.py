"""The examples of "Your project, not ours", compiled for their cores and run in emulators, with stand-ins for their SDKs.

The stand-ins in sdk/ declare what the examples call; main_*.c play it. No vendor's SDK is here.
"""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
OWN = ROOT / "examples/own"
STRICT = "-std=gnu11 -O2 -ffp-contract=off -Wall -Wextra -Wconversion -Wshadow -Wno-unused-function -Werror".split()
M0 = ["-mcpu=cortex-m0plus", "-mthumb"]
M33 = ["-mcpu=cortex-m33", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard"]
RV32 = ["-march=rv32imc", "-mabi=ilp32", "-misa-spec=2.2", "--specs=picolibc.specs"]


@dataclass
class Target:
    """An example and where it runs."""

    compiler: list[str]
    machine: list[str]
    sdk: str
    flash: str = "0"
    ram: str = "0x20000000"
    engine: str = "q31"
    dac_bits: int = 16


TARGETS = {
    "rp2040": Target(["arm-none-eabi-gcc", *M0], ["qemu-system-arm", "-M", "microbit"], "pico"),
    "stm32g0": Target(["arm-none-eabi-gcc", *M0], ["qemu-system-arm", "-M", "microbit"], "stm32g0", dac_bits=12),
    "esp32c3": Target(["riscv64-unknown-elf-gcc", *RV32], ["qemu-system-riscv32", "-M", "virt", "-bios", "none"], "esp_idf"),
    "cortex_m33": Target(["arm-none-eabi-gcc", *M33], ["qemu-system-arm", "-M", "mps2-an505"], "", "0x10000000", "0x38000000",
                         "f32"),
}


def run(*command: object) -> str:
    """What a program says; QEMU puts what picolibc prints on its standard error."""
    done = subprocess.run([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                          timeout=60)
    assert done.returncode == 0, f"{command}\n{done.stdout}"
    return done.stdout


def linked(target: Target, work: Path) -> list[object]:
    """What the linker needs of the emulated machine: start-up code and memories."""
    if target.machine[0] == "qemu-system-riscv32":
        return ["--oslib=semihost", "--crt0=hosted", "-Wl,--defsym=__flash=0x80000000", "-Wl,--defsym=__flash_size=4M",
                "-Wl,--defsym=__ram=0x80400000", "-Wl,--defsym=__ram_size=4M"]
    script = (ROOT / "port/cortex_m/cortex_m.ld").read_text()
    assert "ORIGIN = 0x20000000" in script
    (work / "machine.ld").write_text(script.replace("ORIGIN = 0x20000000", f"ORIGIN = {target.ram}"))
    return [ROOT / "tests/emulator/board.c", "--specs=rdimon.specs", "-nostartfiles", "-T", work / "machine.ld",
            "-Wl,--gc-sections", f"-Wl,--defsym=flash_origin={target.flash}", "-Wl,--defsym=flash_size=256K",
            "-Wl,--defsym=ram_size=16K"]


def codes_of(name: str, params: Path, work: Path, *options: str) -> list[int]:
    """The codes that an example's DAC outputs, tick by tick."""
    target = TARGETS[name]
    includes = [f"-I{folder}" for folder in (ROOT / "lib/include", params, OWN, HERE / "sdk" / target.sdk)]
    objects = []
    for source in (OWN / f"{name}.c", OWN / "axis.c"):
        objects.append(work / f"{source.stem}.o")
        run(*target.compiler, *STRICT, *includes, *options, "-c", source, "-o", objects[-1])
    image = work / "image"
    run(*target.compiler, "-std=gnu11", "-O2", "-ffp-contract=off", "-ffunction-sections", *includes, *objects,
        *sorted((ROOT / "lib/src").glob("*.c")), *options, HERE / f"main_{name}.c", *linked(target, work), "-o", image)
    said = run(*target.machine, "-nographic", "-monitor", "none", "-serial", "none", "-semihosting", "-kernel", image)
    return [int(line) for line in said.split()]


def parameters(dac_bits: int, work: Path) -> Path:
    """A model file for a DAC of that many bits, with rdpi_params.h beside it."""
    model = json.loads((ROOT / "examples/track/params/model.json").read_text())
    model["drive"]["dac_bits"] = dac_bits
    (work / "model.json").write_text(json.dumps(model))
    run(sys.executable, "-m", "rdpi", "header", work / "model.json", "-o", work / "rdpi_params.h")
    return work


def host_codes(target: Target, work: Path) -> list[int]:
    """The codes by `rdpi compensate`, after the sweep."""
    height = 160 - np.abs(np.arange(400) % 320 - 160)
    if target.engine == "f32":
        reference_um = (np.float32(0.05) * height.astype(np.float32)).astype(float)
    else:
        header = (work / "rdpi_params.h").read_text()
        per_um = float(re.search(r"\(\(int32_t\)\(\(\(double\)\(um\) - \(0\.0\)\) \* \((\S+)\)", header)[1])
        reference_um = int(0.05 * per_um + 0.5) * height / per_um
    rows = [f"{k / 1000!r},{um!r}" for k, um in enumerate(reference_um.tolist())]
    (work / "reference.csv").write_text("\n".join(["time_s,reference_um", *rows, ""]))
    run(sys.executable, "-m", "rdpi", "compensate", "--sweep", "--engine", target.engine, work / "model.json",
        work / "reference.csv", "-o", work / "drive.csv")
    with (work / "drive.csv").open() as file:
        return [int(row["dac_code"]) for row in csv.DictReader(line for line in file if not line.startswith("#"))]


@pytest.mark.parametrize("name", TARGETS)
def test_the_dac_gets_the_codes_of_the_host(tmp_path: Path, name: str) -> None:
    params = parameters(TARGETS[name].dac_bits, tmp_path)
    codes, expected = codes_of(name, params, tmp_path), host_codes(TARGETS[name], tmp_path)
    assert len(set(expected)) > 100 and len(codes) > 800
    begin = next(k for k in range(len(codes) - 399) if codes[k:k + 400] == expected)
    swept = codes[:begin]
    assert min(swept) == 0 and max(swept) == 2 ** TARGETS[name].dac_bits - 1  # the sweep went from end to end


def test_a_dma_reads_no_code_that_a_data_cache_holds_back(tmp_path: Path) -> None:
    """The example with a DMA as on a Cortex-M7: memory has only what the cache was told to write back."""
    params = parameters(12, tmp_path)
    assert codes_of("stm32g0", params, tmp_path, "-DCACHED") == codes_of("stm32g0", params, tmp_path)


def test_every_line_of_the_cache_that_has_a_byte_of_a_buffer_is_written_back(tmp_path: Path) -> None:
    """dma.h on this computer: which address and how many bytes it hands to CMSIS."""
    main = tmp_path / "main.c"
    main.write_text(r"""
        #include <stdint.h>
        #include <stdio.h>
        #define __DCACHE_PRESENT 1U
        static uint8_t bytes[96] __attribute__((aligned(32)));
        static void SCB_CleanDCache_by_Addr(uint32_t *address, int32_t count)
        {
            printf("%d %d\n", (int)((uint8_t *)address - bytes), (int)count);
        }
        #include "dma.h"
        static uint32_t codes[8] DMA_BUFFER;
        int main(void)
        {
            dma_publish(bytes, 32);
            dma_publish(bytes + 30, 4);
            dma_publish(bytes + 63, 1);
            return (uintptr_t)codes % DMA_LINE != 0;
        }""")
    run("cc", "-std=c99", "-Wall", "-Wextra", "-Werror", f"-I{OWN}", main, "-o", tmp_path / "program")
    assert run(tmp_path / "program").split() == ["0", "32", "0", "34", "32", "32"]


def test_a_core_that_may_have_a_data_cache_must_say_so() -> None:
    for core, option, passes in (("m7", "", False), ("m4", "", False), ("m4", "-D__CORTEX_M=4U", True),
                                  ("m4", "-D__DCACHE_PRESENT=0U", True), ("m0plus", "", True)):
        done = subprocess.run(["arm-none-eabi-gcc", f"-mcpu=cortex-{core}", "-mthumb", "-fsyntax-only", *option.split(),
                               "-x", "c", OWN / "dma.h"], capture_output=True, text=True)
        assert (done.returncode == 0) == passes, done.stderr
        assert passes or "include the chip's CMSIS header" in done.stderr


ON_A_BUS = "esp32c3", "rp2040"  # examples with a DAC on the SPI


@pytest.mark.parametrize("name", [*ON_A_BUS, "cortex_m33"])
def test_a_code_whose_frame_failed_is_output_in_the_next_tick(tmp_path: Path, name: str) -> None:
    """Three frames fail at the peak of the reference: the library counts on the peak, so the DAC must get it."""
    params = parameters(16, tmp_path)
    whole = codes_of(name, params, tmp_path)
    peak = len(whole) - 400 + int(np.argmax(whole[-400:]))
    codes = codes_of(name, params, tmp_path, f"-DFAIL_AT={peak}u", "-DFAIL_TIMES=3u")
    assert len(codes) == len(whole) and whole[peak] > whole[peak - 1]
    assert codes[:peak] == whole[:peak]
    assert codes[peak:peak + 4] == 3 * [whole[peak - 1]] + [whole[peak]]
    late = np.abs(np.subtract(codes, whole))[peak + 10:]  # a tick later it would be some hundred codes
    assert late.max() <= 5


@pytest.mark.parametrize("name", ON_A_BUS)
def test_a_bus_that_stays_dead_stops_the_axis(tmp_path: Path, name: str) -> None:
    """Ten frames are tried. The program itself checks that the timer is off and the application was called."""
    params = parameters(16, tmp_path)
    codes = codes_of(name, params, tmp_path, "-DFAIL_AT=500u", "-DFAIL_TIMES=UINT32_MAX")
    assert len(codes) == 510 and set(codes[500:]) == {codes[499]}


def test_another_dac_is_refused(tmp_path: Path) -> None:
    params = parameters(12, tmp_path)
    with pytest.raises(AssertionError, match="fit with --dac-bits 16"):
        codes_of("rp2040", params, tmp_path)


def test_two_axes_are_two_objects(tmp_path: Path) -> None:
    """The line of README.md that compiles axis.c once per axis: each has its own start, as its own header says."""
    said = re.search(r"^ *cc (.*?)-o axis_x\.o$", (OWN / "README.md").read_text(), re.DOTALL | re.MULTILINE)[1]
    main = tmp_path / "main.c"
    main.write_text(r"""
        #include <stdio.h>
        #include "axis.h"
        #define AXIS(name) rdpi_status_t name##_start(uint32_t); uint32_t name##_first_code(void); \
            uint32_t name##_next(uint32_t); axis_reference_t name##_reference(uint32_t sample) { return 0 * sample; }
        AXIS(x)
        AXIS(y)
        int main(void)
        {
            if (x_start(1000) != RDPI_OK || y_start(1000) != RDPI_OK) {
                return 1;
            }
            printf("%u %u ", (unsigned)x_first_code(), (unsigned)y_first_code());
            printf("%u %u", (unsigned)x_next(0), (unsigned)y_next(0));
        }""")
    objects, params, alone = [], {"x": 16, "y": 12}, []
    for name, bits in params.items():
        (folder := tmp_path / f"params_{name}").mkdir()
        parameters(bits, folder)
        words = said.replace("\\\n", " ").replace("params_x", str(folder)).replace("=x_", f"={name}_").split()
        words = [word.replace("-Ilib", f"-I{ROOT}/lib").replace("axis.c", str(OWN / "axis.c")) for word in words]
        objects.append(tmp_path / f"axis_{name}.o")
        run("cc", *words, "-o", objects[-1])
        alone.append(2**bits - 1)
    run("cc", f"-I{ROOT / 'lib/include'}", f"-I{OWN}", f"-I{tmp_path / 'params_x'}", main, *objects,
        *sorted((ROOT / "lib/src").glob("*.c")), "-o", tmp_path / "program")
    x, y, next_x, next_y = map(int, run(tmp_path / "program").split())
    assert x / alone[0] == pytest.approx(y / alone[1], abs=1 / alone[1])
    assert next_x / alone[0] == pytest.approx(next_y / alone[1], abs=1 / alone[1]) and next_x > 4095


def test_lost_samples_count_as_time(tmp_path: Path) -> None:
    """axis.c on this computer, in both kinds of numbers: every third sample of a ramp has no call of its own."""
    params = parameters(16, tmp_path)
    main = tmp_path / "main.c"
    main.write_text(r"""
        #include <stdio.h>
        #include "axis.h"
        static uint32_t latest;
        axis_reference_t axis_reference(uint32_t sample)
        {
            latest = sample + 1;
            return AXIS_UM(0.1) * (axis_reference_t)sample;
        }
        int main(void)
        {
            if (axis_start(1000) != RDPI_OK) {
                return 1;
            }
            while (latest == 0) {
                axis_next(0); /* the sweep, and the first reference */
            }
            for (int k = 0; k < 60; k++) {
                unsigned code = axis_next(k % 2);
                printf("%u %u\n", (unsigned)latest, code);
            }
        }""")
    for q31 in (0, 1):
        program = tmp_path / f"program{q31}"
        run("cc", f"-DAXIS_Q31={q31}", f"-I{ROOT / 'lib/include'}", f"-I{params}", f"-I{OWN}", main, OWN / "axis.c",
            *sorted((ROOT / "lib/src").glob("*.c")), "-o", program)
        samples, codes = np.array([line.split() for line in run(program).splitlines()], int).T
        assert samples[-1] == 1 + 60 + 30
        per_sample = np.diff(codes)[10:] / np.diff(samples)[10:]
        assert set(np.diff(samples)) == {1, 2}
        steepness = per_sample[1:] / per_sample[:-1]  # 1 but where a play engages; a wrong rate makes it go up and down
        assert 0.7 < steepness.min() and steepness.max() < 1.2
