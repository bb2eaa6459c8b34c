# SPDX-License-Identifier: Apache-2.0
"""Every requirement of docs/safety.md has its tests, and every test that claims one is listed."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROW = re.compile(r"^\| (S-\d{2,3}) \|(.*)\|$", re.MULTILINE)
SAFETY = (ROOT / "docs/safety.md").read_text()
MEASURED = set(re.findall(r'"(S-\d{2,3})"', (ROOT / "benchmark/faults.py").read_text()))
Trace = dict[str, set[str]]  # requirement -> tests


def listed(page: str) -> Trace:
    return {ident: set(re.findall(r"`(test_\w+)`", row)) for ident, row in ROW.findall(page)}


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
    assert len(listed(SAFETY)) > 30
    assert broken(listed(SAFETY), tests) == []


def test_no_requirement_is_listed_twice() -> None:
    idents = [ident for ident, _ in ROW.findall(SAFETY)]
    assert sorted(set(idents)) == sorted(idents)


def test_what_the_benchmark_of_faults_measures_has_its_figure() -> None:
    """A column of every table holds the worst that was seen, or that it was not measured yet."""
    cells = {ident: row.split("|")[1].strip() for ident, row in ROW.findall(SAFETY)}
    assert len(MEASURED) > 8 and MEASURED <= cells.keys()
    assert [
        ident for ident in sorted(MEASURED) if not re.search(r"\d|^not measured yet$", cells[ident])
    ] == []


def test_a_broken_trace_is_reported() -> None:
    page = listed("| S-01 | a | `test_x` |\n| S-02 | b | |\n| S-03 | c | `test_y` |")
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
