"""Which kernels are compiled together: the table of modules is the whole truth about the decorators."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
import warp as wp

from maomaps_warp import kernels
from maomaps_warp.kernels import modules

FOLDER = Path(kernels.__file__).parent


def _modules_of_kernels(file):
    """Name of the module constant of each kernel in a file; None for a kernel in the file's own module."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        for decorator in getattr(node, "decorator_list", ()):
            if ast.unparse(decorator).startswith("wp.kernel"):
                keywords = decorator.keywords if isinstance(decorator, ast.Call) else ()
                yield next((ast.unparse(word.value) for word in keywords if word.arg == "module"), None)


def test_each_module_lists_exactly_the_files_with_its_kernels():
    found = {name: set() for name in modules.FILES}
    for file in FOLDER.glob("*.py"):
        for constant in _modules_of_kernels(file):
            if constant is not None:
                found[getattr(modules, constant)].add(file.stem)
    assert found == {name: set(files) for name, files in modules.FILES.items()}


def test_a_file_does_not_divide_its_kernels_among_modules():
    for file in FOLDER.glob("*.py"):
        assert len(set(_modules_of_kernels(file))) <= 1, file.name


@pytest.mark.parametrize("module", modules.FILES)
def test_every_module_rounds_alike_everywhere_and_has_no_gradients(module):
    modules.import_kernels(module)
    options = wp.get_module_options(module)
    assert options["fuse_fp"] is False
    assert options["enable_backward"] is False
    assert wp.get_module(module).kernels


def test_jobs_name_modules_that_exist():
    assert {module for names in modules.JOBS.values() for module in names} <= set(modules.FILES)


def test_every_public_kernel_name_is_where_the_table_says():
    for name in kernels.__all__:
        assert getattr(kernels, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = kernels.nothing


def test_files_with_kernels_leave_their_annotations_as_they_are():
    for file in FOLDER.glob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert "\n@wp." not in text or "from __future__ import annotations" not in text, file.name
