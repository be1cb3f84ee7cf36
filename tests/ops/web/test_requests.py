"""Checks of requests, and the files of the page as a browser gets them; test_interface.py sends real requests."""

from __future__ import annotations

import re
from typing import Mapping

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from aiohttp.test_utils import make_mocked_request
from harness.web import Site, with_site

from robot_health_monitor.ops.plot import plot_script
from robot_health_monitor.ops.web.requests import check_same_origin
from robot_health_monitor.runtime.http_answers import ApiError


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({}, True),
        ({"Origin": "http://robot:9090"}, True),
        ({"Origin": "http://ROBOT:9090", "Sec-Fetch-Site": "same-origin"}, True),
        ({"Origin": "http://robot"}, False),
        ({"Origin": "http://robot:9091"}, False),
        ({"Origin": "http://robot:9090.evil.org"}, False),
        ({"Origin": "http://[robot:9090"}, False),
        ({"Origin": "null"}, False),
        ({"Origin": "http://robot:9090", "Sec-Fetch-Site": "cross-site"}, False),
    ],
)
def test_only_the_servers_own_page_may_change_something(headers: Mapping[str, str], allowed: bool) -> None:
    request = make_mocked_request("POST", "/api/reset", headers={"Host": "robot:9090", **headers})
    if allowed:
        check_same_origin(request)
    else:
        with pytest.raises(ApiError) as caught:
            check_same_origin(request)
        assert caught.value.status == 403


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


@pytest.mark.parametrize(("accepted", "encoding"), [("gzip, deflate", "gzip"), ("identity", None)])
def test_files_are_sent_compressed_to_clients_that_accept_it(accepted: str, encoding: str | None) -> None:
    async def use(site: Site) -> None:
        async with site.session.get(f"{site.url}/plot.js", headers={"Accept-Encoding": accepted}) as response:
            assert response.headers.get("Content-Encoding") == encoding
            assert response.headers["Vary"] == "Accept-Encoding"
            assert await response.text() == plot_script()
            assert (int(response.headers["Content-Length"]) < len(plot_script()) / 2) is (encoding == "gzip")

    with_site(use)


def test_the_page_names_all_its_modules_so_that_browsers_fetch_them_at_once() -> None:
    async def use(site: Site) -> None:
        async with site.session.get(f"{site.url}/") as response:
            named = re.findall(r'<link rel="modulepreload" href="([^"]+)">', await response.text())
        imported = set()
        for name in ("start.js", *named):
            status, text = await site.get(f"/{name}")
            assert status == 200
            imported.update(re.findall(r'^import(?: .* from |\()"\./(.+?)"', text, re.MULTILINE))
        assert sorted(named) == sorted(imported)

    with_site(use)


def test_the_plot_is_the_one_of_the_report() -> None:
    async def use(site: Site) -> None:
        assert await site.get("/plot.js") == (200, plot_script())
        assert (await site.get("/plot.css"))[0] == 200

    with_site(use)


@pytest.mark.parametrize("path", ["/nothing.js", "/__init__.py", "/requests.py", "/..%2finterface.py", "/%2e%2e.js"])
def test_nothing_else_is_served(path: str) -> None:
    async def use(site: Site) -> None:
        assert (await site.get(path))[0] == 404

    with_site(use)
