"""The documentation as a site."""

import re
import subprocess
import sys

import pytest

from tests.helpers.pages import ROOT
from tests.helpers.viewer_windows import needs_browser


@pytest.mark.slow
@needs_browser
def test_search_works_from_disk(tmp_path):
    build = ["mkdocs", "build", "--quiet", "--site-dir", str(tmp_path / "site")]
    subprocess.run([sys.executable, "-m", *build], cwd=ROOT, check=True)
    page = (tmp_path / "site" / "index.html").as_uri() + "?q=misfit"
    browser = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    dump = [*browser, "--virtual-time-budget=10000", "--dump-dom", page]
    shown = subprocess.run(dump, capture_output=True, text=True, check=True, timeout=120).stdout
    found = re.search(r'md-search-result__meta">(\d+) matching documents', shown)
    assert found is not None and int(found[1]) > 3
