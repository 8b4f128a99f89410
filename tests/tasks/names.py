"""Names of the task that the tests vary."""

from __future__ import annotations

SHORT_ID = "Schiphol2010-Delta10-v1"
FILE = "schiphol2010-delta10-v1.toml"
