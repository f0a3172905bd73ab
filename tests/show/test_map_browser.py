"""The map in a real browser: choices, keyboard, phone and dark mode."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no chromium found; Debian: apt-get install chromium"
)

# What a reader would do, and what the browser then says of the page.
PROBE = """
<script>
addEventListener("load", function () {
  function all(selector) { return Array.prototype.slice.call(document.querySelectorAll(selector)); }
  function title() { return document.getElementById("title").textContent; }
  function key(name) {
    document.querySelector("#map .chosen").dispatchEvent(
      new KeyboardEvent("keydown", { key: name, bubbles: true }));
    return title();
  }
  function fill() { return document.querySelector("#map .chosen").firstChild.getAttribute("fill"); }
  function pick(name, value) {
    var input = document.querySelector("input[name=" + name + "][value='" + value + "']");
    input.click();
  }
  var seen = { begin: title(), cells: all("#map .cell").length };
  seen.tabbable = all("#map .cell[tabindex='0']").length;
  document.querySelector("#map .chosen").focus();
  seen.keys = ["ArrowDown", "ArrowRight", "ArrowLeft", "ArrowUp"].map(key);
  seen.focused = document.activeElement.getAttribute("aria-label");
  all("#map .cell")[0].dispatchEvent(new MouseEvent("click", { bubbles: true }));
  seen.clicked = title();
  seen.rows = all("#all tbody tr").length;
  var before = fill();
  pick("colour", "mean");
  seen.recoloured = fill() !== before;
  pick("measure", "learned");
  seen.event = document.querySelector(".event").textContent;
  pick("T", 2);
  seen.hot = all("#map .cell").length;
  pick("T", 1);
  pick("corrected", 1);
  seen.corrected = all("#map .cell").length;
  pick("corrected", 0);
  seen.films = all("input[name=task]").map(function (input) {
    input.click();
    var screen = document.getElementById("screen"), kinds = {};
    var pixels = screen.getContext("2d").getImageData(0, 0, 640, 400).data;
    for (var i = 0; i < pixels.length; i += 4) kinds[pixels.slice(i, i + 3).join()] = 1;
    return [screen.getAttribute("aria-label"), Object.keys(kinds).length];
  });
  seen.overflow = document.documentElement.scrollWidth - document.documentElement.clientWidth;
  seen.unnamed = all("#map .cell:not([aria-label]), svg[role=img]:not([aria-label])").length;
  seen.loaded = performance.getEntriesByType("resource").length;
  seen.paper = getComputedStyle(document.body).backgroundColor;
  var probe = document.createElement("pre");
  probe.id = "probe";
  probe.textContent = JSON.stringify(seen);
  document.body.appendChild(probe);
});
</script>
"""


def seen(page: Path, *flags: str) -> dict:
    """The page's own answers after its scripts have run."""
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        f"--user-data-dir={page.parent / 'profile'}", "--virtual-time-budget=1000", *flags,
        "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'<pre id="probe">(.*?)</pre>', done.stdout, flags=re.S)
    assert found, done.stdout[-500:]
    return json.loads(html.unescape(found[1]))


@pytest.fixture
def file(made_map, tmp_path) -> Path:
    page = tmp_path / "map.html"
    page.write_text(made_map.html.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    return page


def test_a_reader_moves_through_the_map(file):
    said = seen(file, "--window-size=1280,900")
    assert said["begin"] == "softmax: 100 % softmax, T = 1"
    assert said["cells"] == 5  # of CartPole, uncorrected, at T = 1
    assert said["tabbable"] == 1
    assert said["keys"][1] != said["keys"][0] != said["begin"]
    assert said["keys"][1].partition(":")[0] in ("random", "ε-greedy", "decaying ε-greedy")
    assert said["focused"].startswith(said["keys"][-1])
    assert said["clicked"] != said["begin"]
    assert said["rows"] == 5
    assert said["recoloured"]
    assert said["event"] == "learned"
    assert said["hot"] == 5  # those without softmax are the same
    assert said["corrected"] == 1
    assert [len({*label.split()}) > 5 for label, _ in said["films"]] == [True] * 3
    assert all(colours > 3 for _, colours in said["films"])
    assert (said["overflow"], said["unnamed"], said["loaded"]) == (0, 0, 0)
    assert said["paper"] == "rgb(255, 255, 255)"


def test_on_a_phone_in_the_dark(file):
    """Headless Chromium has no window narrower than 500 px, so the page is in a frame."""
    frame = file.with_name("phone.html")
    frame.write_text(
        '<body style="margin:0"><iframe src="map.html" width="375" height="900" style="border:0">'
        "</iframe><script>addEventListener('load', function () {"
        "var inner = document.querySelector('iframe').contentDocument;"
        "document.body.appendChild(inner.getElementById('probe').cloneNode(true)); });</script>",
        encoding="utf-8",
    )
    said = seen(frame, "--blink-settings=preferredColorScheme=0", "--allow-file-access-from-files")
    assert said["cells"] == 5
    assert said["overflow"] == 0
    assert said["paper"] == "rgb(23, 26, 31)"
