"""Whatever arrives is answered in words, with the right status, and nothing is simulated by what is refused. Strangers' pages stay out."""

from __future__ import annotations

import json
import re
import shutil
import socket
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from glbench.serve import app
from glbench.serve.sessions import Session, Sessions
from glbench.tasks import TaskSpec
from tests.serve.conftest import JSON, Client, served

LIBRARY_WORDS = re.compile(r"pydantic|traceback|fastapi|starlette|uvicorn|valid integer|input should|\bbody\.|line \d+, in", re.IGNORECASE)
NAMES = ("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr")
STILL = dict.fromkeys(NAMES, 0.0)
HUGE = "1" + "0" * 400


def step(**entries: object) -> str:
    return json.dumps({"action": STILL | entries})


IMPOSSIBLE_STEPS = {
    "nan": (step(uBoil=float("nan")), 422, "action.uBoil", "not finite. Give a number from -1 to 1."),
    "infinity": (step(uVent=float("-inf")), 422, "action.uVent", "not finite"),
    "1e400": ('{"action": [1e400, 0, 0, 0, 0, 0]}', 422, "action.uBoil", "not finite"),
    "10**400": (f'{{"action": [0, {HUGE}, 0, 0, 0, 0]}}', 422, "action.uCo2", "outside its range, -1 to 1"),
    "10**10000": (f'{{"action": [0, {"9" * 10_000}, 0, 0, 0, 0]}}', 400, None, "thousands of digits"),
    "too large": (step(uLamp=1.1), 422, "action.uLamp", "outside its range"),
    "text": (step(uLamp="0.1"), 422, "action.uLamp", "not a number"),
    "truth": (step(uLamp=True), 422, "action.uLamp", "not a number"),
    "nothing": (step(uLamp=None), 422, "action.uLamp", "not a number"),
    "a list inside": (step(uLamp=[0]), 422, "action.uLamp", "not a number"),
    "unknown name": (step(uVents=0), 422, "action.uVents", "Did you mean 'uVent'"),
    "a name is missing": ('{"action": {"uBoil": 0}}', 422, "action", "lacks uCo2"),
    "too short": ('{"action": [0, 0]}', 422, "action", "2 entries"),
    "a number": ('{"action": 1}', 422, "action", "neither an object nor a list"),
    "words": ('{"action": "open the vents"}', 422, "action", "neither an object nor a list"),
    "no action": ('{"steps": 1}', 422, "action", "needs an action"),
    "both": (json.dumps({"action": STILL, "values": STILL}), 422, "action", "both"),
    "no steps": (json.dumps({"action": STILL, "steps": 0}), 422, "steps", "impossible"),
    "half a step": (json.dumps({"action": STILL, "steps": 1.5}), 422, "steps", "impossible"),
    "steps as text": (json.dumps({"action": STILL, "steps": "4"}), 422, "steps", "impossible"),
    "steps without end": (f'{{"action": [0, 0, 0, 0, 0, 0], "steps": {HUGE}}}', 422, "steps", "too many"),
    "more than a day": (json.dumps({"action": STILL, "steps": 97}), 422, "steps", "those of a day, 96"),
    "unknown field": (json.dumps({"action": STILL, "step": 4}), 422, "step", "Did you mean 'steps'"),
    "a list": ("[1, 2]", 422, "body", "JSON object"),
    "a text": ('"step"', 422, "body", "JSON object"),
    "half of it": ('{"action": [0,', 400, None, "not valid JSON (line 1"),
    "no JSON": ("open the vents", 400, None, "not valid JSON"),
    "nested": ("[" * 30_000, 400, None, "not valid JSON"),
    "not text": (b"\xff\xfe{", 400, None, "not valid JSON"),
    "huge": ('{"action": "' + "x" * 70_000 + '"}', 413, "body", "larger than 64 KiB"),
}


@pytest.mark.parametrize("case", IMPOSSIBLE_STEPS)
def test_an_impossible_step_is_refused_in_words_and_nothing_is_simulated(client: Client, session: str, case: str) -> None:
    body, status, field, words = IMPOSSIBLE_STEPS[case]
    got, content = client.raw("POST", f"/v1/sessions/{session}/step", body if isinstance(body, bytes) else body.encode())
    error = json.loads(content)["error"]
    assert (got, error["field"]) == (status, field), error
    assert words in f"{error['what']} {error['do']}"
    assert error["do"].endswith((".", "}."))
    assert len(content) < 1500
    assert not LIBRARY_WORDS.search(content.decode())
    assert client.ok("GET", f"/sessions/{session}/observation")["step"] == 0
    assert client.ok("POST", f"/sessions/{session}/step", {"action": STILL})["step"] == 1


@pytest.mark.parametrize(
    ("body", "status", "field", "words"),
    [
        ({"split": "test"}, 403, "split", "for scores"),
        ({"split": "test"}, 403, "split", "glbench evaluate my_agent.py"),
        ({"split": "preview"}, 422, "split", "'training' or 'validation'"),
        ({"split": "Validation"}, 422, "split", "Did you mean 'validation'?"),
        ({"split": 3}, 422, "split", "such as 'validation'"),
        ({"seed": 10_000}, 422, "seed", "belong to scored runs"),
        ({"seed": -1}, 422, "seed", "a whole number from 10000000000"),
        ({"seed": 2**53}, 422, "seed", "a whole number from 10000000000"),
        ({"seed": 10**400}, 422, "seed", "a whole number from 10000000000"),
        ({"seed": "12"}, 422, "seed", "a whole number from 10000000000"),
        ({"seeds": 1}, 422, "seeds", "Did you mean 'seed'"),
        ([], 422, "body", "JSON object"),
    ],
)
def test_an_impossible_season_is_refused_in_words(client: Client, body: Any, status: int, field: str, words: str) -> None:
    before = client.ok("GET", "/health")["sessions"]
    got, content = client.call("POST", "/sessions", body)
    assert (got, content["error"]["field"]) == (status, field)
    assert words in f"{content['error']['what']} {content['error']['do']}"
    assert not LIBRARY_WORDS.search(json.dumps(content))
    assert client.ok("GET", "/health")["sessions"] == before


@pytest.mark.parametrize(
    ("method", "path", "status", "words"),
    [
        ("GET", "/v1/sessions/nobody/observation", 404, "never started"),
        ("POST", "/v1/sessions/nobody/reset", 404, "never started"),
        ("DELETE", "/v1/sessions/%00%0a", 404, "There is no session"),
        ("GET", "/v1/sessions/nobody/forecasts", 404, "nothing at"),
        ("POST", "/v1/sessions/", 404, "Did you mean '/v1/sessions'"),
        ("POST", "/v1/sessions?split=validation", 422, "Send what it says as JSON in the body"),
        ("GET", "/docs", 404, "The page at / lists all addresses"),
        ("PUT", "/v1/task", 405, "It takes GET"),
        ("GET", "/v1/sessions", 405, "It takes POST"),
    ],
)
def test_a_wrong_address_is_answered_in_words(client: Client, method: str, path: str, status: int, words: str) -> None:
    got, content = client.raw(method, path, b"{}" if method == "POST" else None)
    error = json.loads(content)["error"]
    assert got == status
    assert words in f"{error['what']} {error['do']}"


@pytest.mark.parametrize("kind", ["text/plain", "application/x-www-form-urlencoded", "", "multipart/form-data; boundary=x"])
def test_what_is_not_marked_as_json_is_refused(client: Client, kind: str) -> None:
    headers = {"Content-Type": kind} if kind else {}
    got, content = client.raw("POST", "/v1/sessions", b"{}", headers)
    assert (got, json.loads(content)["error"]["field"]) == (415, "Content-Type")


def test_a_season_needs_no_body_and_json_may_name_its_letters(client: Client) -> None:
    for body, headers in ((None, {}), (b"{}", {"Content-Type": "Application/JSON; charset=utf-8"})):
        got, content = client.raw("POST", "/v1/sessions", body, headers)
        assert got == 201, content
        client.ok("DELETE", f"/sessions/{json.loads(content)['session']}")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8000", "127.0.0.1.evil.example", "", "[::1", "localhost.evil"])
def test_a_name_that_somebody_points_to_this_machine_is_not_answered(client: Client, host: str) -> None:
    got, content = client.raw("GET", "/v1/task", headers={"Host": host})
    assert got == 403
    assert json.loads(content)["error"]["field"] == "Host"


@pytest.mark.parametrize("host", ["127.0.0.1", "LOCALHOST:1", "[::1]:8000", "192.168.1.2"])
def test_addresses_and_the_servers_own_name_are_answered(client: Client, host: str) -> None:
    assert client.raw("GET", "/v1/health", headers={"Host": host})[0] == 200


def test_pages_of_other_origins_are_refused_unless_they_are_allowed(task: TaskSpec) -> None:
    with served(Sessions(task), origins=("http://localhost:1880",)) as client:
        own = {"Origin": f"http://127.0.0.1:{client.port}"}
        for origin, status in (
            ({"Origin": "http://localhost:1880"}, 201),
            (own, 201),
            ({"Origin": "http://evil.example"}, 403),
            ({"Origin": "null"}, 403),
        ):
            client.connection.request("POST", "/v1/sessions", b"{}", JSON | origin)
            answer = client.connection.getresponse()
            answer.read()
            allowed = answer.headers.get("Access-Control-Allow-Origin")
            assert (answer.status, allowed) == (status, "http://localhost:1880" if "1880" in origin["Origin"] else None)
        preflight = {
            "Origin": "http://localhost:1880",
            "Access-Control-Request-Method": "POST",
            "Access-Control-Request-Headers": "content-type",
        }
        client.connection.request("OPTIONS", "/v1/sessions", headers=preflight)
        answer = client.connection.getresponse()
        answer.read()
        assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (200, "http://localhost:1880")


def test_without_an_allowed_origin_no_answer_can_be_read_by_another_page(client: Client) -> None:
    client.connection.request("GET", "/v1/task", headers={"Origin": "http://127.0.0.1:1"})
    answer = client.connection.getresponse()
    answer.read()
    assert answer.status == 403
    assert not [name for name in answer.headers if name.lower().startswith("access-control")]


def test_a_request_that_never_arrives_is_ended(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "BODY_SECONDS", 0.2)
    with socket.create_connection(("127.0.0.1", client.port), timeout=30) as line:
        line.sendall(b"POST /v1/sessions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 10\r\n\r\n{")
        assert b" 408 " in line.recv(100)


def test_a_mistake_of_the_server_shows_no_traceback(
    task: TaskSpec, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        msg = "secret detail"
        raise ZeroDivisionError(msg)

    with served(Sessions(task)) as client:
        name = client.ok("POST", "/sessions")["session"]
        monkeypatch.setattr(Session, "forecast", fail)
        got, content = client.raw("GET", f"/v1/sessions/{name}/forecast")
        assert (got, b"secret detail" in content, b"Traceback" in content) == (500, False, False)
        assert client.ok("GET", "/health")["status"] == "ok"
    assert "Traceback" not in "".join(capfd.readouterr())
    assert f"GET /v1/sessions/{name}/forecast failed: ZeroDivisionError: secret detail." in caplog.text


def test_the_answers_are_those_of_the_openapi_document(client: Client, session: str) -> None:
    document = client.ok("GET", "/openapi.json")
    calls = [
        ("get", "/v1/health", "/health", None),
        ("post", "/v1/sessions", "/sessions", {"split": "validation"}),
        ("post", "/v1/sessions/{session}/reset", f"/sessions/{session}/reset", {}),
        ("get", "/v1/sessions/{session}/observation", f"/sessions/{session}/observation", None),
        ("post", "/v1/sessions/{session}/step", f"/sessions/{session}/step", {"action": STILL}),
        ("get", "/v1/sessions/{session}/forecast", f"/sessions/{session}/forecast", None),
        ("get", "/v1/sessions/{session}/account", f"/sessions/{session}/account", None),
        ("delete", "/v1/sessions/{session}", f"/sessions/{session}", None),
    ]
    assert {path for _, path, *_ in calls} | {"/v1/task", "/v1/sessions/{session}/episode"} == set(document["paths"])
    for method, path, address, body in calls:
        about = document["paths"][path][method]
        ok = about["responses"]["201" if path == "/v1/sessions" else "200"]["content"]["application/json"]["schema"]
        jsonschema.validate(client.ok(method.upper(), address, body), {**ok, "components": document["components"]})
        assert about["responses"]["4XX"]["content"]["application/json"]["schema"] == {"$ref": "#/components/schemas/Failure"}
        assert "422" not in about["responses"]
        assert about["description"]


def test_the_page_loads_nothing_from_elsewhere_and_names_this_server(client: Client) -> None:
    status, content = client.raw("GET", "/")
    page = content.decode()
    assert status == 200
    assert set(re.findall(r"https?://[\w.:]+", page)) == {f"http://127.0.0.1:{client.port}"}
    assert "<b>my/Spring-v1</b>" in page
    (start,) = re.findall(r"-d '(\{\"split\".*?\})'", page)
    (act,) = re.findall(r"-d '(\{\"steps\".*?\})'", page)
    name = client.ok("POST", "/sessions", json.loads(start))["session"]
    assert client.ok("POST", f"/sessions/{name}/step", json.loads(act))["step"] == 4
    assert "webwrite" in page


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser test")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("there is no chromium on this machine to look at the page with")
    with sync_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        yield chromium
        chromium.close()


@pytest.mark.slow
def test_a_person_can_try_a_season_on_the_page(client: Client, browser: Any) -> None:
    page = browser.new_page()
    problems: list[str] = []
    page.on("console", lambda message: problems.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.goto(f"http://127.0.0.1:{client.port}/")
    page.click("#start", timeout=60_000)
    page.locator("#said", has_text="Step 0 of 192").wait_for(timeout=60_000)
    page.fill("#a-uBoil", "0.5")
    page.click("#step")
    page.locator("#said", has_text="Step 4 of 192").wait_for(timeout=60_000)
    assert "EUR m-2" in page.inner_text("#said")
    assert "26" in page.inner_text("#observations tr:has-text('boiler')")
    assert not problems
    page.fill("#a-uBoil", "7")
    page.click("#step")
    page.locator("#said.bad").wait_for(timeout=60_000)
    assert "values.uBoil is outside its range, -1 to 1" in page.inner_text("#said")
    page.click("#close")
    page.locator("#said", has_text="Closed.").wait_for(timeout=60_000)
    assert page.locator("#addresses tr").count() == 11
    page.close()
