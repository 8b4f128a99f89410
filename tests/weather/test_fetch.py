"""Fetching from KNMI's service: against a loopback server that answers, and fails, in KNMI's own ways."""

from __future__ import annotations

import datetime as dt
import threading
import time
import urllib.parse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from glbench.errors import GlbenchError, WeatherError
from glbench.weather import WeatherRecord, fetch_knmi
from glbench.weather.knmi import KNMI_URL, URL_VARIABLE
from tests.weather.files import KNMI_COMMENTS, KNMI_HEADER, knmi_days, knmi_line, knmi_text

YEAR = 2013
YEAR_ROWS = knmi_days(dt.date(YEAR, 1, 1), 365)


@dataclass
class Service:
    """What the next answer is, and what was asked."""

    url: str = ""
    body: bytes = b""
    status: int = 200
    announced: int | None = None
    wait: float = 0.0
    chunked_cut: bool = False
    asked: list[dict[str, str]] = field(default_factory=list)


def handler(service: Service) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self) -> None:
            length = int(self.headers["Content-Length"])
            service.asked.append(dict(urllib.parse.parse_qsl(self.rfile.read(length).decode())))
            time.sleep(service.wait)
            self.close_connection = True
            try:
                self.send_response(service.status)
                if service.chunked_cut:
                    self.send_header("Transfer-Encoding", "chunked")
                    self.end_headers()
                    self.wfile.write(f"{len(service.body) + 100:x}\r\n".encode() + service.body)
                    return
                announced = len(service.body) if service.announced is None else service.announced
                self.send_header("Content-Length", str(announced))
                self.end_headers()
                self.wfile.write(service.body)
            except (BrokenPipeError, ConnectionResetError):
                return  # the client has gone, as it should after its time is up

        def log_message(self, *_: object) -> None:
            return

    return Handler


@pytest.fixture
def service() -> Iterator[Service]:
    description = Service(body=knmi_text(YEAR_ROWS).encode())
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler(description))
    description.url = f"http://127.0.0.1:{server.server_port}/klimatologie/uurgegevens"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield description
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GLBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.delenv(URL_VARIABLE, raising=False)
    return tmp_path / "cache"


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def fetched(service: Service, **options: float) -> WeatherRecord:
    return fetch_knmi(240, YEAR, url=service.url, timeout_seconds=options.get("timeout", 10.0))


def test_a_year_is_fetched_whole(service: Service) -> None:
    record = fetched(service)
    assert record.name == "knmi-240-2013"
    assert record.period == "2013-01-01 00:00 to 2014-01-01 00:00 UTC"
    assert record.station == "KNMI 240, Schiphol"
    assert "Royal Netherlands Meteorological Institute" in record.licence


def test_knmi_is_asked_for_whole_days_in_its_own_form(service: Service) -> None:
    fetched(service)
    assert service.asked == [{"start": "2013010101", "end": "2013123124", "stns": "240", "vars": "Q:T:U:FH:N", "fmt": "csv"}]


def test_an_extra_day_in_the_answer_is_cut_off(service: Service) -> None:
    whole = fetched(service)
    days = knmi_days(dt.date(2012, 12, 31), 367)
    service.body = knmi_text(days).encode()
    again = fetch_knmi(240, YEAR, url=service.url, refresh=True)
    assert again.hours == 8760
    assert again.digest == whole.digest


@pytest.mark.parametrize(
    "answer",
    [
        knmi_text(YEAR_ROWS, comments=KNMI_COMMENTS * 3),
        knmi_text(YEAR_ROWS, comments=KNMI_COMMENTS[2:], header=KNMI_HEADER.replace("HH", " H")),
        knmi_text(YEAR_ROWS, header=f'"{KNMI_HEADER}"'),
        knmi_text(YEAR_ROWS, end="\n"),
    ],
)
def test_answers_of_every_make_give_the_same_record(service: Service, answer: str) -> None:
    whole = fetched(service)
    service.body = answer.encode()
    assert fetch_knmi(240, YEAR, url=service.url, refresh=True).digest == whole.digest


def test_a_second_fetch_comes_from_the_cache(service: Service) -> None:
    first, second = fetched(service), fetched(service)
    assert first.digest == second.digest
    assert len(service.asked) == 1
    fetch_knmi(240, YEAR, url=service.url, refresh=True)
    assert len(service.asked) == 2


def test_a_changed_cache_file_is_fetched_again(service: Service, cache: Path) -> None:
    first = fetched(service)
    (stored,) = files(cache)
    stored.write_bytes(stored.read_bytes().replace(b"   80,", b"   81,", 1))
    assert fetched(service).digest == first.digest
    assert len(service.asked) == 2


def test_the_address_can_come_from_the_environment(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(URL_VARIABLE, service.url)
    assert fetch_knmi(240, YEAR).hours == 8760
    assert KNMI_URL.startswith("https://www.daggegevens.knmi.nl/")


def test_progress_is_told_in_bytes(service: Service) -> None:
    told: list[tuple[int, int | None]] = []
    fetch_knmi(240, YEAR, url=service.url, progress=lambda received, total: told.append((received, total)))
    assert told[-1] == (len(service.body), len(service.body))
    assert [received for received, _ in told] == sorted(received for received, _ in told)


def test_a_leap_year_has_8784_hours(service: Service) -> None:
    service.body = knmi_text(knmi_days(dt.date(2016, 1, 1), 366)).encode()
    assert fetch_knmi(240, 2016, url=service.url).hours == 8784


def outage(service: Service) -> None:
    service.body = b"<!DOCTYPE html>\n<html><head><title>Storing</title></head><body>Even geduld</body></html>"


def truncated_by_announcement(service: Service) -> None:
    service.announced = len(service.body)
    service.body = service.body[:100_000]


def truncated_in_a_row(service: Service) -> None:
    service.body = service.body[:100_003]


def truncated_after_a_row(service: Service) -> None:
    service.body = knmi_text(YEAR_ROWS[:8000]).encode()


def truncated_chunk(service: Service) -> None:
    service.body = service.body[:100_000]
    service.chunked_cut = True


def server_error(service: Service) -> None:
    service.status, service.body = 500, b"Internal Server Error"


def not_found(service: Service) -> None:
    service.status, service.body = 404, b"no"


def wrong_year(service: Service) -> None:
    service.body = knmi_text(knmi_days(dt.date(2012, 1, 1), 366)).encode()


def other_station(service: Service) -> None:
    service.body = knmi_text(knmi_days(dt.date(YEAR, 1, 1), 365, 209)).encode()


def no_rows(service: Service) -> None:
    service.body = knmi_text([]).encode()


def blank_value(service: Service) -> None:
    rows = YEAR_ROWS.copy()
    rows[30] = knmi_line(dt.date(YEAR, 1, 2), 7, {"N": "     "})
    service.body = knmi_text(rows).encode()


def missing_hour(service: Service) -> None:
    service.body = knmi_text(YEAR_ROWS[:40] + YEAR_ROWS[41:]).encode()


def nothing_at_all(service: Service) -> None:
    service.body = b""


@pytest.mark.parametrize(
    ("breakage", "words"),
    [
        (outage, "it is out of order: try again later"),
        (truncated_by_announcement, r"broke off after 100000 of \d+ bytes. Try again"),
        (truncated_in_a_row, r"row \d+: (\d fields instead of 8|'.*' in column)|8760 hours"),
        (truncated_after_a_row, "8000 of 8760 hours. The answer was cut off, or the year is not over yet"),
        (truncated_chunk, "cannot be reached, or broke off"),
        (server_error, r"HTTP 500 \(Internal Server Error\). Try again later"),
        (not_found, r"HTTP 404 \(Not Found\)"),
        (wrong_year, "it holds no hour of 2013"),
        (other_station, "holds 209, not station 240"),
        (no_rows, "it holds no hour of 2013. Does the station exist"),
        (blank_value, "no value for cloud cover in the hour ending 2013-01-02 07:00 UTC"),
        (missing_hour, "1 h are missing between 2013-01-02 16:00 and 2013-01-02 18:00 UTC"),
        (nothing_at_all, "no KNMI file of hourly values"),
    ],
)
def test_every_failure_is_told_and_nothing_is_kept(service: Service, cache: Path, breakage: Callable[[Service], None], words: str) -> None:
    breakage(service)
    with pytest.raises(WeatherError, match=words):
        fetched(service)
    assert files(cache) == []


def test_a_silent_service_is_given_up(service: Service, cache: Path) -> None:
    service.wait = 0.6
    with pytest.raises(WeatherError, match=r"was silent for 0\.2 s. Try again later, or wait longer with --timeout"):
        fetched(service, timeout=0.2)
    assert files(cache) == []


def test_an_absent_service_is_told(cache: Path) -> None:
    with pytest.raises(WeatherError, match="cannot be reached"):
        fetch_knmi(240, YEAR, url="http://127.0.0.1:9/none", timeout_seconds=5)
    assert files(cache) == []


@pytest.mark.parametrize("url", ["ftp://knmi.nl/", "file:///etc/passwd", "knmi"])
def test_only_web_addresses_are_asked(url: str) -> None:
    with pytest.raises(WeatherError, match="is no web address"):
        fetch_knmi(240, YEAR, url=url)


def test_years_before_the_observations_are_refused(service: Service) -> None:
    with pytest.raises(WeatherError, match="begin in 1951"):
        fetch_knmi(240, 1920, url=service.url)
    assert service.asked == []


def test_gaps_can_be_filled_on_the_way(service: Service) -> None:
    blank_value(service)
    record = fetch_knmi(240, YEAR, url=service.url, fill_gaps=1)
    assert record.hours == 8760
    assert record.notes == ("cloud_cover: 1 h filled linearly, the first of them ending 2013-01-02 07:00 UTC",)


def test_a_service_that_drips_for_ever_is_given_up(service: Service, cache: Path) -> None:
    with pytest.raises(WeatherError, match=r"too slow: \d+ bytes in 0 s.*--total-timeout"):
        fetch_knmi(240, YEAR, url=service.url, total_seconds=0.0)
    assert not files(cache)


def test_station_and_year_are_numbers() -> None:
    with pytest.raises(GlbenchError, match="A year is a whole number; got '2013'"):
        fetch_knmi(240, "2013")  # type: ignore[arg-type]
