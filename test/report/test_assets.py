# SPDX-License-Identifier: Apache-2.0
"""What pages take from others is what those published, with its licence."""

from hashlib import sha256
from pathlib import Path

import pam_orthosis.report

ASSETS = Path(pam_orthosis.report.__file__).parent / "assets"
# of plotly.js-basic-dist-min 4.1.1 of npm
PUBLISHED = "99784e3abfb07b142a15e521a439e6d9addceadb3f79553fd24c72774f0649ba"


def test_plotly_is_as_it_was_published():
    assert sha256((ASSETS / "plotly-basic.min.js").read_bytes()).hexdigest() == PUBLISHED
    assert "MIT" in (ASSETS / "plotly-LICENSE").read_text(encoding="utf-8")
