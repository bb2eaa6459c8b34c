# SPDX-License-Identifier: Apache-2.0
"""Every requirement of docs/safety.md has its tests, and docs/safety_tests.md lists them."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROW = re.compile(r"^\| (S-\d{2,3}) \|(.*)\|$", re.MULTILINE)
SAFETY = (ROOT / "docs/safety.md").read_text()
TESTS = (ROOT / "docs/safety_tests.md").read_text()
Trace = dict[str, set[str]]  # requirement -> tests


def listed(rows: str, tests: str) -> Trace:
    """Tests that a page lists below the id of each requirement that another page states."""
    parts = re.split(r"^\*\*(S-\d{2,3})\*\*$", tests, flags=re.MULTILINE)
    below = dict(zip(parts[1::2], parts[2::2], strict=True))
    stated = {ident for ident, _ in ROW.findall(rows)} | below.keys()
    return {
        ident: set(re.findall(r"`(test_\w+)`", below.get(ident, ""))) for ident in sorted(stated)
    }


def marked(*sources: str) -> Trace:
    """Tests by the requirements that their markers name."""
    tests: Trace = {}
    for source in sources:
        for function in ast.walk(ast.parse(source)):
            for mark in getattr(function, "decorator_list", ()):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func).endswith("requirement"):
                    for ident in mark.args:
                        tests.setdefault(ast.literal_eval(ident), set()).add(function.name)
    return tests


def broken(page: Trace, tests: Trace) -> list[str]:
    """Mismatches, one line each."""
    found = [f"{ident} has no test" for ident, names in page.items() if not names]
    found += [f"no requirement {ident}: {sorted(tests[ident])}" for ident in tests.keys() - page]
    for ident, names in page.items():
        carried = tests.get(ident, set())
        found += [f"{name} does not carry {ident}" for name in sorted(names - carried)]
        found += [f"{name} is not in the row of {ident}" for name in sorted(carried - names)]
    return found


def test_every_requirement_has_its_tests_and_every_test_its_requirement() -> None:
    tests = marked(*(path.read_text() for path in sorted((ROOT / "test").rglob("test_*.py"))))
    page = listed(SAFETY, TESTS)
    assert len(page) > 30 and page.keys() == {ident for ident, _ in ROW.findall(SAFETY)}
    assert broken(page, tests) == []


def left_out(source: str) -> list[str]:
    """Tests of requirements that `make test` leaves out, wholly or in part."""
    body = ast.parse(source).body
    whole = any(isinstance(node, ast.Assign) and "mark.long" in ast.unparse(node) for node in body)
    marks = {
        node.name: " ".join(map(ast.unparse, node.decorator_list))
        for node in body
        if isinstance(node, ast.FunctionDef)
    }
    verifies = {name: text for name, text in marks.items() if "mark.requirement" in text}
    return [name for name, text in verifies.items() if whole or "mark.long" in text]


def test_no_test_of_a_requirement_is_left_out_by_make_test() -> None:
    files = sorted((ROOT / "test").rglob("test_*.py"))
    assert [name for path in files for name in left_out(path.read_text())] == []
    requirement, long = '@pytest.mark.requirement("S-01")\n', "pytestmark = pytest.mark.long\n"
    test = f"{requirement}@pytest.mark.parametrize('x', [pytest.param(1, marks=pytest.mark.long)])"
    assert left_out(f"{test}\ndef test_x(x): ...\n") == ["test_x"]
    assert left_out(f"{long}{requirement}def test_y(): ...\ndef test_z(): ...") == ["test_y"]


def test_what_make_test_leaves_out_is_run_by_the_ci() -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert '-m "not long and not alone" $(ARGS)\n\t$(if $(ARGS),,' in makefile
    assert "-m pytest -m alone test/nodes)\n" in makefile
    alone = [
        path
        for path in (ROOT / "test").rglob("test_*.py")
        if "@pytest.mark.alone" in path.read_text()
    ]
    assert {path.parent for path in alone} <= {ROOT / "test/nodes", ROOT / "test"}
    for file in (".ci/run", ".github/workflows/ci.yml"):
        lines = re.findall(r"make test\b.*", (ROOT / file).read_text())
        assert re.findall(r"-m (\w+)", " ".join(lines)) == ["long"]


def test_no_requirement_is_listed_twice() -> None:
    idents = [ident for ident, _ in ROW.findall(SAFETY)]
    assert sorted(set(idents)) == sorted(idents)


def test_every_benchmark_that_gave_a_figure_is_there() -> None:
    measured = (ROOT / "docs/evidence/faults.md").read_text()
    named = set(re.findall(r"benchmark\.(\w+)", SAFETY + measured))
    assert len(named) > 4
    assert [name for name in sorted(named) if not (ROOT / f"benchmark/{name}.py").exists()] == []


def test_a_broken_trace_is_reported() -> None:
    rows = "| S-01 | a | - |\n| S-02 | b | - |\n| S-03 | c | - |"
    page = listed(rows, "**S-01**\n\n* `test_x`\n\n**S-03**\n\n* `test_y`\n")
    tests = marked(
        '@pytest.mark.requirement("S-01", "S-09")\ndef test_x(): ...\n'
        '@pytest.mark.requirement("S-01")\ndef test_z(): ...'
    )
    assert broken(page, tests) == [
        "S-02 has no test",
        "no requirement S-09: ['test_x']",
        "test_z is not in the row of S-01",
        "test_y does not carry S-03",
    ]
