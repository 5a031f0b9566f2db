"""What `conan create` does with a recipe: conan_create.py RECIPE CACHE PREFIX. Prints what the recipe says, as JSON."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from pathlib import Path

recipe, cache, prefix = map(Path, sys.argv[1:])
spec = importlib.util.spec_from_file_location("conanfile", recipe / "conanfile.py")
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
for pattern in module.Rdpi.exports_sources:
    for path in recipe.rglob("*") if pattern.endswith("*") else [recipe / pattern]:
        if path.is_file() and path.relative_to(recipe).match(pattern) or pattern.endswith("/*") and path.is_file() \
                and path.is_relative_to(recipe / pattern[:-2]):
            target = cache / path.relative_to(recipe)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
made = module.Rdpi(str(cache), str(prefix))
for step in ("configure", "layout", "generate", "build", "package", "package_info"):
    getattr(made, step)()
print(json.dumps({"name": made.name, "version": made.version, "libs": made.cpp_info.libs}))
