"""The files of the page, as a browser gets them."""

from __future__ import annotations

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from harness.web import Site, with_site

from robot_health_monitor.ops.plot import plot_script


def test_the_page_is_protected_by_a_strict_policy() -> None:
    async def use(site: Site) -> None:
        async with site.session.get(f"{site.url}/") as response:
            assert (response.status, response.content_type, response.charset) == (200, "text/html", "utf-8")
            policy = dict(part.split(" ", 1) for part in response.headers["Content-Security-Policy"].split("; "))
            assert policy["default-src"] == "'none'"
            assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
            assert policy["frame-ancestors"] == policy["base-uri"] == "'none'"
            assert response.headers["X-Content-Type-Options"] == "nosniff"
            assert response.headers["Referrer-Policy"] == "no-referrer"

    with_site(use)


def test_a_file_that_has_not_changed_is_not_sent_again() -> None:
    async def use(site: Site) -> None:
        async with site.session.get(f"{site.url}/") as response:
            etag = response.headers["ETag"]
        async with site.session.get(f"{site.url}/", headers={"If-None-Match": etag}) as response:
            assert (response.status, await response.read()) == (304, b"")
            assert response.headers["ETag"] == etag
        assert (await site.get("/", headers={"If-None-Match": '"other"'}))[0] == 200

    with_site(use)


def test_the_plot_is_the_one_of_the_report() -> None:
    async def use(site: Site) -> None:
        assert await site.get("/plot.js") == (200, plot_script())
        assert (await site.get("/plot.css"))[0] == 200

    with_site(use)


@pytest.mark.parametrize("path", ["/nothing.js", "/__init__.py", "/page_files.py", "/..%2finterface.py", "/%2e%2e.js"])
def test_nothing_else_is_served(path: str) -> None:
    async def use(site: Site) -> None:
        assert (await site.get(path))[0] in (404, 426)

    with_site(use)
