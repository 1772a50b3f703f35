"""What is written about the code is true: citations exist, docstrings name every argument, links lead somewhere."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import shipgrid
from shipgrid.scenarios.results import CITATION, bibliography, open_results

ROOT = Path(__file__).parents[2]
SOURCE = sorted((ROOT / "src" / "shipgrid").rglob("*.py"))
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE}
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
THEORY = sorted((ROOT / "docs" / "theory").glob("*.md"))
DOCUMENTED = (ast.FunctionDef, ast.ClassDef, ast.Module)


def name_of(path):
    return str(path.relative_to(ROOT))


def docstrings(tree):
    return [text for node in ast.walk(tree) if isinstance(node, DOCUMENTED) and (text := ast.get_docstring(node))]


def functions(tree):
    """Functions and methods with the docstring that describes their arguments: `__init__` has its class's."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name != "__init__":
            yield node.name, node, ast.get_docstring(node) or ""
        elif isinstance(node, ast.ClassDef):
            for item in node.body:
                if isinstance(item, ast.FunctionDef) and item.name == "__init__":
                    yield node.name, item, ast.get_docstring(node) or ""


def arguments(function):
    a = function.args
    return [arg.arg for arg in [*a.posonlyargs, *a.args, *a.kwonlyargs] if arg.arg not in ("self", "cls")]


def test_the_keys_that_are_cited_are_in_the_bibliography():
    cited = {key for tree in TREES.values() for text in docstrings(tree) for key in CITATION.findall(text)}
    cited |= {
        key
        for tree in TREES.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword) and node.arg == "source" and isinstance(node.value, ast.Constant)
        for key in CITATION.findall(str(node.value.value))
    }
    assert "DAgostino2020" in cited, "the search for citations finds nothing"
    bibliography(sorted(cited))  # raises with the list of those that are missing


def test_the_keys_that_pages_cite_are_in_the_bibliography():
    cited = {key for page in PAGES for key in CITATION.findall(page.read_text(encoding="utf-8"))}
    assert "Alexander1977" in cited, "the search for citations finds nothing"
    bibliography(sorted(cited))  # raises with the list of those that are missing


def test_pages_and_equations_that_the_source_names_exist():
    source = "\n".join(path.read_text(encoding="utf-8") for path in SOURCE)
    named = set(re.findall(r"docs/[a-z_/]+/[\w-]+\.md", source))
    assert "docs/theory/converters.md" in named, "the search for pages finds nothing"
    assert [page for page in sorted(named) if not (ROOT / page).is_file()] == []
    tags = {tag for page in THEORY for tag in re.findall(r"\\tag\{([a-z-]+-\d+)\}", page.read_text(encoding="utf-8"))}
    equations = set(re.findall(r"\(([a-z]+-\d+)\)", source))
    assert "nodal-1" in equations, "the search for equations finds nothing"
    assert sorted(equations - tags) == []


def test_docs_and_package_share_one_bibliography():
    assert (ROOT / "docs/references.bib").read_text() == (ROOT / "src/shipgrid/data/references.bib").read_text()


@pytest.mark.parametrize("path", SOURCE, ids=name_of)
def test_a_docstring_that_lists_parameters_lists_all_of_them(path):
    missing = [
        f"{name}: {argument}"
        for name, function, text in functions(TREES[path])
        if "Parameters\n---" in text
        for argument in arguments(function)
        if not re.search(rf"\b{re.escape(argument)}\b", text)
    ]
    assert missing == []


@pytest.mark.parametrize("name", getattr(shipgrid, "__all__", ()))
def test_a_public_name_describes_every_argument(name):
    thing = getattr(shipgrid, name)
    text = inspect.getdoc(thing)
    assert text, f"{name} has no docstring"
    if callable(thing):
        missing = [a for a in inspect.signature(thing).parameters if not re.search(rf"\b{re.escape(a)}\b", text)]
        assert missing == []


@pytest.mark.parametrize("path", SOURCE, ids=name_of)
def test_every_module_says_what_it_is_for(path):
    if path.name == "__init__.py" and not path.read_text().strip():
        return
    assert ast.get_docstring(TREES[path])


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_links_of_a_page_lead_to_files(path):
    links = re.findall(r"\]\(([^)#]+?)\)", path.read_text(encoding="utf-8"))
    broken = [link for link in links if "://" not in link and not (path.parent / link).exists()]
    assert broken == []


def test_the_changelog_has_an_unreleased_section():
    assert "## Unreleased" in (ROOT / "CHANGELOG.md").read_text()


def readme_examples() -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)


def test_the_circuit_example_of_the_readme_runs():
    _, _, code = readme_examples()
    names = {"sg": shipgrid}
    exec(compile(code, "README.md", "exec"), names)
    # closed at 1 ms on a capacitor behind 0.5 ohm and 1 mH: up to 100 V (1 + exp(-pi alpha/omega)) at half a period
    far = names["run"]["far.v_dc"]
    assert float(far.max()) == pytest.approx(178.0, rel=0.03)
    assert float(far[-1]) == pytest.approx(100.0, abs=2.0)


def test_the_python_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    """As it stands there, but for the length of the run: two seconds of the hour."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    code, _, _ = readme_examples()
    whole = shipgrid.simulate
    monkeypatch.setattr(shipgrid, "simulate", lambda *args, **options: whole(*args, **options, until=2.0))
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    run = names["run"]
    assert run.summary["simulated_s"] == pytest.approx(2.0, abs=1e-4)
    assert run.settings["ship"]["equipment"]["bess_for"]["capacity"] == "160 Ah"
    assert (tmp_path / "mission.html").stat().st_size > 0
    assert open_results("results/more-battery").signals == run.signals  # the path that the text below it names
    said = capsys.readouterr().out
    assert "DC bus fore" in said and "@article" in said


def test_the_session_of_the_readme_runs():
    _, code, _ = readme_examples()
    names = {"sg": shipgrid}
    exec(compile(code, "README.md", "exec"), names)
    session = names["session"]
    assert session.time == pytest.approx(15.0, abs=1e-4)
    assert 700.0 < session.read("dc_for.v_dc") < 790.0 and session.read("propulsion_for.omega_m") > 0.1


def python_of(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "how-to" / page).read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", ["sessions.md", "add_a_device.md"])
def test_the_examples_of_a_page_run(page, capsys):
    names = {"sg": shipgrid}
    for code in python_of(page):
        exec(compile(code, page, "exec"), names)
    if page == "add_a_device.md":
        assert float(names["run"]["dc.v_dc"][-1]) == pytest.approx(98.26, abs=0.01)  # as the page says


def test_no_page_has_a_figure_left_open():
    """Words in capitals stand where a figure was to come; files are the only ones that are called so."""
    files = {path.stem for path in ROOT.glob("*.md")} | {"CITATION", "PYTHONPATH"}
    for page in PAGES:
        left = set(re.findall(r"\b[A-Z]{8,}\b", page.read_text(encoding="utf-8"))) - files
        assert not left, f"{name_of(page)}: {left}"
