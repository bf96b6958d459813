"""What a process pays for before its first frame."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mocodec import native

CODE = """
import sys
from mocodec.codecs.bodycast import Bodycast
from mocodec.testing import actors, sequences
clouds = sequences.record(sequences.jumping_jacks(actors.capsules(), 3), 6000, seed=1)
assert "scipy" not in sys.modules, "testing imports SciPy"
encoded = Bodycast(max_error=0.002).encode(clouds)
Bodycast.decode(encoded)
assert "scipy" not in sys.modules, "SciPy was imported"
"""


@pytest.mark.skipif(not native.available(), reason="NumPy code has SciPy's trees")
def test_a_person_is_coded_without_scipy():
    """SciPy takes a quarter of a second to import."""
    pytest.importorskip("av")
    done = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
