"""What comes from files or from the command line is data: never code, a command or a path."""

from __future__ import annotations

import ast
import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from trl_explore.config import composing, job_name, register_resolvers
from trl_explore.jobs.files import ResultsError
from trl_explore.jobs.reading import find_folders, find_jobs
from trl_explore.report.loading import load
from trl_explore.report.writing import build_report

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(
    p for f in ("trl_explore", "scripts", "benchmarks") for p in (ROOT / f).rglob("*.py")
)
LOADERS = {"pickle", "cPickle", "_pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
NAMES = {"eval", "exec", "compile", "__import__"}
OWNED = {
    ("torch", "load"), ("pd", "read_pickle"), ("np", "fromfile"), ("os", "system"), ("os", "popen"),
    ("yaml", "load"), ("yaml", "unsafe_load"), ("yaml", "full_load"),
}  # fmt: skip
PIPES = {"trl_explore/envs/processes.py": {"pickle"}}
"""Talk with processes that they started themselves, over pipes of their own; they open no file."""
EVIL = (
    "<script>alert(1)</script>&amp;\"'\\input{x}%$#_{}~^\n\\end{tabular}|`*[x](javascript:1)\r-->"
)


def calls(tree: ast.AST) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]


def name_of(call: ast.Call) -> str:
    function = call.func
    return function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_source_loads_a_pickle_or_runs_a_text(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = {
        alias.name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in ([*node.names, ast.alias(node.module or "")]
                      if isinstance(node, ast.ImportFrom) else node.names)
    }  # fmt: skip
    place = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else ""
    assert not imported & (LOADERS - PIPES.get(place, set()))
    if place in PIPES:
        assert not {"open", "read_bytes", "load_file"} & {name_of(call) for call in calls(tree)}
    for call in calls(tree):
        name, keywords = name_of(call), {k.arg for k in call.keywords}
        assert not (isinstance(call.func, ast.Name) and name in NAMES), f"{path}:{call.lineno}"
        assert "allow_pickle" not in keywords, f"{path}:{call.lineno}"
        assert "shell" not in keywords, f"{path}:{call.lineno}"
        owner = getattr(getattr(call.func, "value", None), "id", "")
        assert (owner, name) not in OWNED, f"{path}:{call.lineno}"


def test_the_search_for_pickles_finds_them(tmp_path):
    for text in (
        "import pickle",
        "from pickle import loads",
        "import os\nos.system('x')",
        "eval('1')",
        "import torch\ntorch.load('x')",
        "np.load('x', allow_pickle=True)",
    ):
        (tmp_path / "x.py").write_text(text)
        with pytest.raises(AssertionError):
            test_no_source_loads_a_pickle_or_runs_a_text(tmp_path / "x.py")


def test_the_only_resolvers_are_two_names():
    """``${...}`` in a configuration computes nothing but the name of a sweep and of a job."""
    before = set(dir(OmegaConf))
    register_resolvers()
    assert OmegaConf.has_resolver("sweep_folder")
    assert OmegaConf.has_resolver("job_name")
    assert set(dir(OmegaConf)) == before
    for path in (ROOT / "trl_explore").rglob("*.py"):
        registered = [
            c for c in calls(ast.parse(path.read_text())) if name_of(c) == "register_new_resolver"
        ]
        assert bool(registered) == (path.parts[-2:] == ("config", "job_names.py"))


@pytest.mark.parametrize(
    ("target", "known"),
    [
        ("trl_explore.strategies.Softmax", True),
        ("trl_explore.strategies.schedules.Linear", True),
        ("trl_explore.strategies.schedules.Exponential", True),
        ("trl_explore.envs.make_env", True),
        ("trl_explore.strategies.schedules.check_number", False),
        ("trl_explore.strategies.schedules.ABC", False),
        ("trl_explore.strategies.schedules.Linear.__init__", False),
        ("trl_explore.jobs.writing.clear", False),
        ("trl_explore.jobs.writing.write_job", False),
        ("torch.optim.lr_scheduler.torch.load", False),
        ("torch.load", False),
        ("os.system", False),
        ("builtins.eval", False),
        ("hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher", False),
        (3, False),
        ("", False),
    ],
)
def test_a_recorded_configuration_constructs_what_conf_does(target, known):
    assert composing._is_known(target) == known


# The report


class Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.scripts: list[str] = []
        self.links: list[str] = []
        self.handlers: list[str] = []
        self._in_script = False

    def handle_starttag(self, tag, attrs):
        self._in_script = tag == "script"
        for key, value in attrs:
            if key.startswith("on"):
                self.handlers.append(key)
            if key in ("href", "src", "xlink:href"):
                self.links.append(value or "")

    def handle_endtag(self, tag):
        self._in_script = False

    def handle_data(self, data):
        if self._in_script:
            self.scripts.append(data)


def spoil(job: Path, **record) -> None:
    run = json.loads((job / "run.json").read_text())
    (job / "run.json").write_text(json.dumps({**run, **record}))


@pytest.fixture
def evil(tmp_path, make_job) -> Path:
    """Two jobs all of whose texts are meant to be taken for something else."""
    folder_name = EVIL.replace("/", "").replace("\n", "").replace("\r", "")[:80]
    for k, name in enumerate((folder_name, "other")):
        job = make_job(
            tmp_path / "in" / folder_name, name, [150, 200 + k, 1000], strategy=EVIL,
            parameters={EVIL: EVIL, "x": k}, env=EVIL,
        )  # fmt: skip
        spoil(job, experiment=EVIL, collector=EVIL, versions={EVIL: EVIL}, machine={EVIL: EVIL})
        (job / ".hydra" / "overrides.yaml").write_text(f"- {EVIL}\n- a={EVIL!r}\n")
    bad = make_job(tmp_path / "in" / folder_name, f"bad{folder_name}", [150])
    (bad / "trials.csv").write_text(f"{EVIL}\n")
    return tmp_path


def test_texts_of_results_are_only_text_in_the_page(evil):
    page, gaps = build_report([evil / "in"], evil / "out")
    assert len(gaps) == 1
    html = page.read_text(encoding="utf-8")
    parsed = Page()
    parsed.feed(html)
    own = (ROOT / "trl_explore" / "report" / "page.js").read_text(encoding="utf-8")
    assert "".join(parsed.scripts).strip() == own.strip()
    assert parsed.handlers == []
    assert all(link.startswith(("#", "data:")) for link in parsed.links)
    assert "<script>alert" not in html
    assert "&lt;script&gt;alert" in html  # it is there, as text


def test_texts_of_results_are_only_text_in_the_tables(evil):
    build_report([evil / "in"], evil / "out")
    latex = [path.read_text(encoding="utf-8") for path in (evil / "out" / "tables").glob("*.tex")]
    markdown = [p.read_text(encoding="utf-8") for p in (evil / "out" / "tables").glob("*.md")]
    assert latex
    assert markdown
    for text in latex:
        assert "\\input{" not in text
        assert text.count("\\end{tabular}") == 1
        begin = text.index("\\begin{tabular}")
        assert text.startswith("% ")
        assert text[:begin].count("\n") == 1  # one line of comment before it
    for text in markdown:
        assert "<script" not in text
        bars = [line.replace("\\|", "").count("|") for line in text.splitlines()]
        assert len(set(bars)) == 1


def everything(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "name", ["../../escaped", "{here}/escaped", "a/../../b", "..", "CON", "\U0001d4b3" * 90]
)
def test_a_name_from_results_is_no_path(tmp_path, make_job, name):
    name = name.replace("{here}", str(tmp_path))  # an absolute path, where it would be seen
    for k in range(2):
        job = make_job(tmp_path / "in" / "sweep", f"job{k}", [150, 200 + k], parameters={"x": k})
        spoil(job, experiment=name, strategy=name)
    before = everything(tmp_path / "in")
    build_report([tmp_path / "in"], tmp_path / "place" / "out")
    assert everything(tmp_path / "in") == before
    assert {p.name for p in tmp_path.iterdir()} == {"in", "place"}
    assert {p.name for p in (tmp_path / "place").iterdir()} == {"out"}
    written = [p for p in (tmp_path / "place" / "out").rglob("*") if p.is_file()]
    assert {p.relative_to(tmp_path / "place" / "out").parts[0] for p in written} == {
        "index.html", "methods.md", "references.bib", "figures", "tables",
    }  # fmt: skip


def test_names_that_look_the_same_as_files_stay_apart(tmp_path, make_job):
    for name in ("a/b", "a-b"):
        spoil(make_job(tmp_path / name.replace("/", "_"), "job", [150, 200]), experiment=name)
    page, _ = build_report([tmp_path], tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    assert text.count('id="a-b-1"') == text.count('id="a-b-2"') == 1


def test_timings_name_a_job_and_no_place(tmp_path, make_job):
    make_job(tmp_path / "in" / "train", "softmax", [150, 200])
    (tmp_path / "in" / "train" / "timings.csv").write_text(
        "experiment,job,trial,seconds,frames\ntrain,../../x,0,0.5,9\n/etc,/passwd,1,0.5,9\n"
    )
    loaded = load([tmp_path / "in"])
    assert loaded.jobs[0].timing is None
    build_report([tmp_path / "in"], tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"in", "out"}


@pytest.mark.parametrize("what", ["figures", "tables", "index.html", "figures/file"])
def test_a_report_is_not_written_through_a_link(tmp_path, make_job, what):
    """Results that come from elsewhere may hold links, where the report goes by default."""
    make_job(tmp_path / "in" / "train", "softmax", [150, 200])
    out, target = tmp_path / "in" / "report", tmp_path / "target"
    build_report([tmp_path / "in"], out)
    target.mkdir()
    (target / "kept").write_text("mine")
    if what == "figures/file":
        (out / "index.html").write_text("not a report")
        for file in (out / "figures").iterdir():
            file.unlink()
            file.symlink_to(target / "kept")
    else:
        place = out / what
        place.rename(tmp_path / "old")
        place.symlink_to(target / "kept" if what == "index.html" else target)
    build_report([tmp_path / "in"], out)
    assert {p.name: p.read_text() for p in target.iterdir()} == {"kept": "mine"}
    assert not any(p.is_symlink() for p in out.rglob("*"))


def test_a_report_folder_that_is_a_link_is_refused(tmp_path, make_job):
    make_job(tmp_path / "in" / "train", "softmax", [150, 200])
    (tmp_path / "target").mkdir()
    (tmp_path / "in" / "report").symlink_to(tmp_path / "target")
    with pytest.raises(ResultsError, match="is a link"):
        build_report([tmp_path / "in"], tmp_path / "in" / "report")
    assert list((tmp_path / "target").iterdir()) == []


def test_links_to_folders_are_not_followed(tmp_path, make_job):
    make_job(tmp_path / "elsewhere", "softmax", [150])
    make_job(tmp_path / "in", "argmax", [150])
    (tmp_path / "in" / "link").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "in" / "loop").symlink_to(tmp_path / "in")
    assert [job.name for job in find_jobs(tmp_path / "in")] == ["argmax"]
    assert len(find_folders(tmp_path / "in")) == 1


# Folders


def test_any_output_folder_serves(tmp_path, run_many):
    names = ["a b", "ü", "<b>&", "x=y,z", "$HOME", "100%", "[1]", "-x"]
    short = ["experiment=debug", "trials=1", "max_iterations=2"]
    for ran in run_many([[*short, f"output_dir='{name}'"] for name in names], tmp_path):
        assert ran.returncode == 0, ran.stderr
    assert {p.name for p in tmp_path.iterdir()} == set(names)
    assert all(len(find_jobs(tmp_path / name)) == 1 for name in names)


@pytest.mark.parametrize("value", ["../../../x", "/x", "..", "a/../../b"])
def test_a_value_is_no_path_in_the_name_of_a_job(value):
    """Names are made of values; what could lead out of the folder is quoted."""
    config = OmegaConf.create({"strategy": {"temperature": value}})
    name = job_name(config, {"strategy": "softmax"})
    assert "/" not in name
    assert name not in ("", ".", "..")
