"""Nothing above the model names a state, a control or a parameter of a model, or counts them."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import glbench
from glbench.model import registered_models

PACKAGE = Path(glbench.__file__).parent
ABOVE = [path for path in sorted(PACKAGE.rglob("*.py")) if "model" not in path.relative_to(PACKAGE).parts[:1]]
# Names that are words as well.
WORDS = {"time", "g", "L", "R", "S", "H", "eps", "alpha", "theta", "sigma", "pressure"}
# Examples in what a message says is allowed.
EXAMPLES = {"tasks/tables.py": {"uVent", "cFruit"}}
# The rule-based controller of the paper reads the true air.
PRIVILEGED = {"agents/rules.py": {"tAir", "vpAir", "co2Air"}}
# `glbench validate` sets one model against measurements: its lamps, the crop that was planted, the air, the pipes and the harvest.
MEASURED = {
    "realism/houses.py": {"thetaLampMax", "etaLampCool", "etaLampPar", "zetaLampPar", "cFruitMax"},
    "realism/free_run.py": {"tAir", "vpAir", "co2Air", "tPipe", "tGroPipe"},
    "realism/season.py": {
        *("tAir", "vpAir", "co2Air", "sumMcFruitHar", "tPipe", "tGroPipe"),
        *("tCan", "tCan24", "tCanSum", "cBuf", "cLeaf", "cStem", "cFruit"),
    },
}
# `glbench greenhouse` describes the greenhouse of one model: its floor, roof, heating, lamps, screens and vents.
_HOUSE = {
    *("aFlr", "aCov", "hAir", "hGh", "psi", "aRoof", "hVent", "pBoil", "phiExtCo2", "phiPipeE", "phiPipeI", "lPipe"),
    *("tauRfPar", "tauThScrPar", "tauBlScrPar", "epsThScrFir", "tauThScrFir", "kThScr"),
    *("thetaLampMax", "etaLampPar", "etaLampNir", "zetaLampPar", "aLamp", "tauLampPar", "tauLampNir", "tauLampFir"),
    *("tAir", "tPipe", "rgFruit"),
}
DESCRIBED = {f"greenhouse/{name}.py": _HOUSE for name in ("capability", "draft", "page", "parameters", "writing")}
# Rules that call the crew, and the dispatch of the machines of the energy system, each by the controls' names.
WORKED = {"agents/harvest_rules.py": {"uHarvest"}, "bounds/commitment.py": {"uBoil", "uChp", "eBufEdge"}}
GLOBALS = re.compile(r"\b(STATE|CONTROL|DISTURBANCE|PARAMETER)_NAMES\b")
COUNTS = re.compile(r"\(n, (?:28|208)\)|\((?:28|208),\)|\b(?:28 states|208 parameters)\b")


def names_of_models() -> set[str]:
    models = registered_models()
    vectors = (names for model in models for names in (model.state_names, model.control_names, model.parameter_names))
    return set().union(*vectors) - WORDS


def test_there_is_more_than_one_model_to_look_for() -> None:
    assert {"tAir", "cFruit", "xN", "uBoil", "sla", "cAlpha"} <= names_of_models()
    assert len(ABOVE) > 150


@pytest.mark.parametrize("path", ABOVE, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_no_file_above_the_model_names_or_counts_its_variables(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    literals = {node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant) and isinstance(node.value, str)}

    named = (EXAMPLES | PRIVILEGED | MEASURED | DESCRIBED | WORKED).get(path.relative_to(PACKAGE).as_posix(), set())
    assert literals & names_of_models() <= named
    assert not GLOBALS.search(text)
    assert not COUNTS.search(text)
