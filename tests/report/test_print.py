"""The printed preload report: no clipped content, no orphaned headings, no split flanges."""

import base64
import re

import preload_report_studies as studies
import pytest
from browser import CHROMIUM, Browser

from stiffopt.report.preload.page import write_preload_report

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
]

# A4 less 14 mm all round, at 96 pixels an inch.
WIDTH, HEIGHT = (int((side - 28) / 25.4 * 96) for side in (210, 297))


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        browser.size(WIDTH, HEIGHT)
        browser.call("Emulation.setEmulatedMedia", media="print")
        yield browser


@pytest.fixture(scope="module", params=["flange", "several"])
def page(request, printed, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    printed.open(write_preload_report(getattr(studies, request.param)(), folder))
    return printed


def test_printed_content_fits_the_paper(page):
    assert page.value("document.documentElement.scrollWidth") <= WIDTH
    cut = """[...document.querySelectorAll('main *')].filter(e =>
        e.getBoundingClientRect().right > document.documentElement.clientWidth + 1
        && !e.closest('svg')).map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"""
    assert page.value(cut) == []


def test_printed_headings_stay_with_their_content(page):
    alone = """[...document.querySelectorAll('h2, h3')].filter(e =>
        getComputedStyle(e).breakAfter !== 'avoid').map(e => e.textContent)"""
    assert page.value(alone) == []
    torn = """[...document.querySelectorAll('figure, .whole, .signatures, tr')].filter(e =>
        e.closest('.sheet') && getComputedStyle(e).breakInside !== 'avoid').length"""
    assert page.value(torn) == 0


def test_printed_flange_sheet_fits_one_page(page):
    heights = page.value("[...document.querySelectorAll('.whole')].map(e => e.offsetHeight)")
    assert heights
    assert max(heights) < HEIGHT
    assert page.value("getComputedStyle(document.querySelector('.sheet')).breakBefore") == "page"


def test_folded_sections_are_printed(page):
    hidden = """[...document.querySelectorAll('details table')].filter(e =>
        !e.checkVisibility({contentVisibilityAuto: true}) || !e.offsetHeight).length"""
    assert page.value("document.querySelectorAll('details:not([open]) table').length") > 0
    assert page.value(hidden) == 0


def test_page_prints_to_pdf(page):
    printed = page.call("Page.printToPDF", preferCSSPageSize=True)["data"]
    document = base64.b64decode(printed)
    assert document.startswith(b"%PDF")
    sizes = set(re.findall(rb"/MediaBox \[([^]]*)\]", document))
    # A4 in points, whatever the printer's default.
    assert [round(float(x)) for x in sizes.pop().split()] == [0, 0, 595, 842]
    assert not sizes
    assert not page.console
