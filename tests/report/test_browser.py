"""The page in a real browser: it renders, sorts by a click, and loads nothing from outside."""

from __future__ import annotations

import functools
import html
import http.server
import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from trl_explore.report.writing import build_report

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium found; Debian: apt-get install chromium"
)

# What a reader would do, and what the browser then says of the page.
PROBE = """
<script>
addEventListener("load", function () {
  var table = document.getElementById("thesis-configurations");
  var column = Array.prototype.findIndex.call(
    table.tHead.rows[0].cells, function (c) { return c.textContent === "mean iterations"; });
  var heading = table.tHead.rows[0].cells[column];
  function values() {
    return Array.prototype.map.call(
      table.tBodies[0].rows, function (r) { return r.cells[column].dataset.value; });
  }
  var seen = { before: values() };
  heading.querySelector("button").click();
  seen.ascending = values();
  seen.sort = heading.getAttribute("aria-sort");
  heading.querySelector("button").click();
  seen.descending = values();
  seen.figures = Array.prototype.map.call(document.querySelectorAll("figure svg"), function (s) {
    var box = s.getBoundingClientRect();
    return [box.width, box.height];
  });
  seen.overflow = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  seen.width = document.documentElement.clientWidth;
  seen.answer = document.querySelector(".answer").innerText;
  seen.loaded = performance.getEntriesByType("resource").map(function (r) { return r.name; });
  var probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify(seen);
  document.body.appendChild(probe);
});
</script>
"""

# The page in a frame as wide as a phone, in which no script may run.
PHONE = """
<body style="margin:0">
<iframe sandbox="allow-same-origin" src="page.html" width="375" height="900" style="border:0">
</iframe>
<script>
addEventListener("load", function () {
  var page = document.querySelector("iframe").contentDocument;
  function all(selector, of) {
    return Array.prototype.map.call(page.querySelectorAll(selector), of);
  }
  var probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify({
    width: page.documentElement.clientWidth,
    overflow: page.documentElement.scrollWidth - page.documentElement.clientWidth,
    scripted: page.getElementById("probe") !== null || page.querySelector("th button") !== null,
    figures: all("figure svg", function (s) { return s.getBoundingClientRect().width; }),
    headings: all("th", function (h) { return h.textContent; }),
    answer: page.querySelector(".answer").innerText
  });
  document.body.appendChild(probe);
});
</script>
"""


class Recorder(http.server.SimpleHTTPRequestHandler):
    """Serves a folder and keeps what was asked for."""

    asked: list[str]

    def do_GET(self) -> None:
        self.asked.append(self.path)
        super().do_GET()

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture
def served(tmp_path: Path, made) -> Iterator[tuple[str, list[str]]]:
    """The page with the probe at its end, on a server that records every request."""
    page = made.html.replace("</body>", PROBE + "</body>")
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    (tmp_path / "phone.html").write_text(PHONE, encoding="utf-8")
    asked: list[str] = []
    handler = type("Handler", (Recorder,), {"asked": asked})
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(handler, directory=str(tmp_path))
    )
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", asked
    server.shutdown()
    thread.join()
    server.server_close()


def open_page(url: str, profile: Path, *flags: str) -> str:
    """The page's own HTML after its scripts have run."""
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--disable-quic", "--hide-scrollbars", f"--user-data-dir={profile}",
        "--virtual-time-budget=20000", *flags, "--dump-dom", url,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


def probe(dom: str) -> dict:
    found = re.search(r'<pre id="probe">(.*?)</pre>', dom, flags=re.S)
    assert found, dom[-500:]
    return json.loads(html.unescape(found[1]))


def test_the_page_renders_sorts_and_loads_nothing(served, tmp_path, made):
    url, asked = served
    seen = probe(open_page(f"{url}/page.html", tmp_path / "profile", "--window-size=1280,900"))
    numbers = [float(value) for value in seen["before"]]
    assert [float(value) for value in seen["ascending"]] == sorted(numbers)
    assert [float(value) for value in seen["descending"]] == sorted(numbers, reverse=True)
    assert numbers != sorted(numbers)
    assert seen["sort"] == "ascending"
    assert len(seen["figures"]) == len(list((made.out / "figures").glob("*.svg")))
    assert all(width > 300 and height > 100 for width, height in seen["figures"])
    assert "fastest" in seen["answer"]
    assert seen["overflow"] == 0
    assert seen["loaded"] == []
    assert asked == ["/page.html"]


WIDTHS = """
<script>
addEventListener("load", function () {
  var seen = {};
  document.querySelectorAll(".scroll").forEach(function (s) {
    seen[s.querySelector("table").id] = s.scrollWidth - s.clientWidth;
  });
  var probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify(seen);
  document.body.appendChild(probe);
});
</script>
"""


def test_tables_of_long_names_are_not_cut_off_on_a_wide_screen(tmp_path, make_job):
    # Names such as "decaying ε-greedy, per-decision weights", numbers as wide as they get.
    for correction in ("NoCorrection", "PerDecision", "Trajectory"):
        for k, strategy in enumerate(("argmax", "decaying_epsilon_greedy")):
            taken = [400 + 97 * ((5 * n + k) % 7) for n in range(12)]
            make_job(tmp_path / "corrections", f"{strategy},{correction}", taken,
                     strategy=strategy, groups={"correction": correction})  # fmt: skip
    page, _ = build_report([tmp_path / "corrections"], tmp_path / "out")
    text = page.read_text(encoding="utf-8").replace("</body>", WIDTHS + "</body>")
    (tmp_path / "wide.html").write_text(text, encoding="utf-8")
    size = "--window-size=1280,900"
    seen = probe(open_page(f"file://{tmp_path}/wide.html", tmp_path / "profile", size))
    assert {"corrections-configurations", "corrections-pairs"} < seen.keys()
    assert {name: beyond for name, beyond in seen.items() if beyond > 0} == {}


def test_the_page_fits_a_phone_and_stands_without_javascript(served, tmp_path, made):
    url, asked = served
    seen = probe(open_page(f"{url}/phone.html", tmp_path / "profile", "--window-size=900,1000"))
    assert seen["width"] == 375
    assert seen["overflow"] == 0
    assert seen["scripted"] is False
    assert len(seen["figures"]) == len(list((made.out / "figures").glob("*.svg")))
    assert all(250 < width <= 375 for width in seen["figures"])
    assert "mean iterations" in seen["headings"]
    assert "fastest" in seen["answer"]
    assert set(asked) <= {"/phone.html", "/page.html", "/favicon.ico"}
