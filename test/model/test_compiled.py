# SPDX-License-Identifier: Apache-2.0
"""The cache of machine code: whatever is in it or becomes of it, functions work."""

import shutil

import casadi as ca
import pytest

from pam_orthosis.model import compiled as module
from pam_orthosis.model.compiled import compiled


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PAM_ORTHOSIS_NO_COMPILER", raising=False)
    return tmp_path / "pam_orthosis"


def square():
    x = ca.SX.sym("x")
    return ca.Function("square", [x], [x**2])


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs a compiler")
@pytest.mark.parametrize("content", [b"", b"\x7fELF cut short"])
def test_a_library_that_was_cut_short_is_built_anew(cache, content):
    assert compiled(square())(3.0)[0][0] == 9.0
    (library,) = cache.glob("*.so")
    library.unlink()
    library.write_bytes(content)
    assert compiled(square())(3.0)[0][0] == 9.0
    (library,) = cache.glob("*.so")
    assert library.stat().st_size > 1000


def test_where_nothing_can_be_written_the_virtual_machine_computes(cache, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_compile", full)
    assert compiled(square())(3.0)[0][0] == 9.0
    assert list(cache.glob("*.so")) == []
