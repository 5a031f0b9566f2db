"""Compiles the firmware library into the package, as rdpi.firmware._f32 (RDPI_REAL=float) and rdpi.firmware._f64 (double)."""

from __future__ import annotations

import re
import shutil
from copy import copy
from pathlib import Path

from cffi import FFI
from setuptools import Extension
from setuptools.command.build_ext import build_ext

HERE = Path(__file__).resolve().parent
LIB = next(path for path in (HERE / "lib", HERE.parent / "lib") if path.is_dir())  # in an sdist, in a checkout
BATCH = HERE / "firmware"
REAL = {"rdpi.firmware._f32": "float", "rdpi.firmware._f64": "double"}
# Larger than the firmware's: memory is no concern here, and identification tries finer models than are flashed.
MAXIMA = {"RDPI_MAX_PLAYS": "129", "RDPI_MAX_DEADZONES": "65", "RDPI_MAX_WINDOW": "4096"}


def declarations() -> str:
    """The part of batch.h that is written for cffi."""
    return re.search(r"/\* cffi-begin \*/(.*)/\* cffi-end \*/", (BATCH / "batch.h").read_text(), re.DOTALL)[1]


class BuildFirmware(build_ext):
    """Fills in the sources only now and in a copy: setuptools must not see files that lie above setup.py."""

    def build_extension(self, ext: Extension) -> None:
        work = Path(self.build_temp) / ext.name  # one each: both compile the same files
        work.mkdir(parents=True, exist_ok=True)
        ffi = FFI()
        ffi.cdef(declarations())
        ffi.set_source(ext.name, '#include "batch.h"')
        ffi.emit_c_code(str(work / "glue.c"))
        # Copies, because setuptools links in the order of whole paths: the same bytes wherever the checkout lies.
        for source in (*LIB.glob("src/*.c"), *BATCH.glob("*.c")):
            shutil.copy(source, work)

        ext = copy(ext)
        ext.sources = sorted(str(path) for path in work.glob("*.c"))
        ext.include_dirs = [str(LIB / "include"), str(LIB / "src"), str(BATCH)]  # src: its private headers
        ext.define_macros = [("RDPI_REAL", REAL[ext.name]), *MAXIMA.items()]
        # Contraction to fused multiply-add would make results depend on the machine; debugging information, the file on
        # the directory it is built in.
        ext.extra_compile_args = ["-std=c99", "-O2", "-ffp-contract=off", "-g0"]
        build_temp, self.build_temp = self.build_temp, str(work)
        super().build_extension(ext)
        self.build_temp = build_temp


EXTENSIONS = [Extension(name, sources=[]) for name in REAL]
