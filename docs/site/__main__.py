"""Builds the documentation site: ``python -m docs.site OUT`` (docs/maintain.md)."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from docs.site.build import build
from docs.site.pages import SiteError

if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m docs.site", description="Build the documentation site.")
    parser.add_argument("out", type=Path, help="folder of all versions; made if it is not there")
    parser.add_argument("--version", default="dev", help="folder and name of this version, such as 0.1.0; default: dev")
    chosen = parser.parse_args()
    try:
        page = build(chosen.out, chosen.version)
    except SiteError as error:
        sys.exit(str(error))
    print(f"{page}: version {chosen.version}, all links lead somewhere.")
