"""Conan 2: `conan create .` in this directory."""

from conan import ConanFile
from conan.tools.cmake import CMake, CMakeToolchain, cmake_layout


class Rdpi(ConanFile):
    name = "rdpi"
    version = "@VERSION@"
    description = "Linearises hysteretic actuators, above all piezos, in open loop"
    license = "MIT"
    package_type = "static-library"
    settings = "os", "compiler", "build_type", "arch"
    exports_sources = "CMakeLists.txt", "LICENSE", "lib/*"

    def configure(self):
        self.settings.rm_safe("compiler.cppstd")  # it is C
        self.settings.rm_safe("compiler.libcxx")

    def layout(self):
        cmake_layout(self)

    def generate(self):
        toolchain = CMakeToolchain(self)
        toolchain.cache_variables["RDPI_BUILD_TESTS"] = "OFF"
        toolchain.cache_variables["RDPI_BUILD_EXAMPLES"] = "OFF"
        toolchain.generate()

    def build(self):
        cmake = CMake(self)
        cmake.configure()
        cmake.build()

    def package(self):
        CMake(self).install()

    def package_info(self):
        self.cpp_info.libs = ["rdpi"]
        self.cpp_info.set_property("cmake_target_name", "rdpi::rdpi")
