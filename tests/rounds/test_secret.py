"""The secret of a round: what is committed to, the file, and what is refused."""

from __future__ import annotations

import datetime as dt
import hashlib
import stat
from pathlib import Path

import pytest

from glbench.errors import GlbenchError, TaskError
from glbench.tasks import Round, SealedWeather, TaskSpec, get_task, read_round
from glbench.tasks.sealed import weather_of, write_round
from tests.cli.command_line import Command
from tests.rounds.conftest import OTHER, SECRET
from tests.rounds.tiny import write_tiny

WEATHER = SealedWeather("ab" * 32, (2019, 2020))


def test_the_commitment_is_the_sha_256_of_the_lines_that_the_page_names() -> None:
    assert SECRET.commitment == hashlib.sha256(b"glbench round 1\n" + b"5" * 64).hexdigest()
    own = Round("5" * 64, WEATHER)
    text = b"glbench round 1\n" + b"5" * 64 + b"\n" + b"ab" * 32 + b"\n2019 2020"
    assert own.commitment == hashlib.sha256(text).hexdigest()
    assert weather_of(own.secret) == WEATHER
    assert weather_of(SECRET.secret) is None


def test_salts_have_256_bits_and_never_repeat() -> None:
    salts = {Round.new().salt for _ in range(50)}
    assert len(salts) == 50
    assert all(len(bytes.fromhex(salt)) == 32 for salt in salts)


def test_a_file_is_read_as_it_was_written_and_only_its_owner_may_read_it(tmp_path: Path) -> None:
    for number, sealed in enumerate((Round.new(), Round.new(WEATHER))):
        file = tmp_path / "rounds" / f"{number}.toml"
        write_round(sealed, file)
        assert read_round(file) == sealed
        assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_round_never_replaces_a_file(tmp_path: Path) -> None:
    file = tmp_path / "round.toml"
    write_round(SECRET, file)
    with pytest.raises(GlbenchError, match="only copy of a secret"):
        write_round(OTHER, file)
    assert read_round(file) == SECRET


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("5" * 64, "4" + "5" * 63, "One of them was changed"),
        (SECRET.commitment, OTHER.commitment, "One of them was changed"),
        ("5" * 64, "5" * 63, "64 hexadecimal digits"),
        ('"' + "5" * 64 + '"', "5", "64 hexadecimal digits"),
        ("schema_version = 1", "schema_version = 2", "not a round's file of this glbench"),
        ("glbench/round", "glbench/result", "not a round's file of this glbench"),
        ("salt =", "pepper =", "odd: pepper"),
        ("salt =", "salt", "not TOML"),
    ],
)
def test_a_file_that_was_changed_is_refused_without_showing_the_salt(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = tmp_path / "round.toml"
    file.write_text(SECRET.to_toml().replace(old, new), encoding="utf-8")
    with pytest.raises(GlbenchError, match=words) as caught:
        read_round(file)
    assert "5" * 60 not in str(caught.value)


@pytest.mark.parametrize("weather", ['digest = "x"\nyears = [2019]', f'digest = "{"ab" * 32}"\nyears = []', 'digest = "x"', "years = 3"])
def test_weather_that_cannot_be_is_refused(tmp_path: Path, weather: str) -> None:
    file = tmp_path / "round.toml"
    file.write_text(SECRET.to_toml() + f"\n[weather]\n{weather}\n", encoding="utf-8")
    with pytest.raises(GlbenchError):
        read_round(file)


@pytest.mark.parametrize("years", [(2020, 2019), (2019, 2019), (2019.0,), (True,), (19,)])
def test_years_ascend_and_occur_once(years: tuple[int, ...]) -> None:
    with pytest.raises(GlbenchError, match="ascend"):
        Round("5" * 64, SealedWeather("ab" * 32, years))


def test_no_words_about_a_round_or_a_task_show_the_salt(tiny: TaskSpec) -> None:
    task = tiny.in_split("test", SECRET.secret)
    for shown in (repr(SECRET), repr(task), str(task), str(task.model_dump()), str(task.as_tables()), repr(vars(task).get("file"))):
        assert SECRET.salt not in shown


def test_a_task_in_a_round_keeps_its_digest_and_other_splits_know_nothing_of_it(tiny: TaskSpec) -> None:
    task = tiny.in_split("test", SECRET.secret)
    assert task.digest == tiny.digest
    assert task.salt_commitment == SECRET.commitment
    assert task.scored is task
    assert tiny.scored.salt_commitment is None
    assert task.in_split("training").salt_commitment is None
    with pytest.raises(TaskError, match="belongs to the test"):
        tiny.in_split("training", SECRET.secret)


def test_a_task_without_splits_cannot_be_sealed() -> None:
    with pytest.raises(TaskError, match="no split 'test'"):
        get_task("glbench/Schiphol2010-Delta10-v1").in_split("test", SECRET.secret)


def test_commands_make_and_check_a_round(glbench: Command, tmp_path: Path) -> None:
    file = tmp_path / "round.toml"
    made = glbench("round", "new", file)
    commitment = made.out.strip()
    assert made.code == 0
    assert commitment == read_round(file).commitment
    assert read_round(file).salt not in made.out + made.err

    checked = glbench("round", "check", file, commitment)
    assert (checked.code, checked.out.strip()) == (0, commitment)
    assert glbench("round", "check", file, OTHER.commitment).code == 1
    assert glbench("round", "new", file).code == 1
    assert glbench("round", "check", tmp_path / "none.toml").code == 1
    assert glbench("round", "new", tmp_path / "own.toml", "--weather", "schiphol").code == 1
    assert glbench("round", "new", tmp_path / "own.toml", "--weather", "schiphol", "--year", "1890").code == 1
    assert not (tmp_path / "own.toml").exists()


def test_a_secret_in_a_checkout_and_weather_that_everyone_has_are_pointed_out(glbench: Command, tmp_path: Path) -> None:
    checkout, outside = tmp_path / "checkout", tmp_path / "outside.toml"
    (checkout / ".git").mkdir(parents=True)
    assert f"is in the git checkout {checkout}" in glbench("round", "new", checkout / "submissions" / "round.toml").err
    made = glbench("round", "new", outside, "--weather", "schiphol", "--year", "2011")
    assert made.code == 0
    assert "is the record 'schiphol' that comes with glbench" in made.err
    assert "git" not in made.err


CLOSES = dt.datetime(2027, 3, 1, 18, 0, tzinfo=dt.timezone(dt.timedelta(hours=1)))


def test_the_commitment_covers_the_closing_time(tmp_path: Path) -> None:
    for weather, lines in ((None, b""), (WEATHER, b"\n" + b"ab" * 32 + b"\n2019 2020")):
        sealed = Round("5" * 64, weather, CLOSES)
        text = b"glbench round 1\n" + b"5" * 64 + lines + b"\ncloses 2027-03-01T17:00:00Z"
        assert sealed.commitment == hashlib.sha256(text).hexdigest()
        assert weather_of(sealed.secret) == weather
        file = tmp_path / f"{weather is None}.toml"
        write_round(sealed, file)
        assert read_round(file) == sealed
        later = file.read_text(encoding="utf-8").replace("2027-03-01T17", "2027-03-01T18")
        file.write_text(later, encoding="utf-8")
        with pytest.raises(GlbenchError, match=r"closing time .* One of them was changed"):
            read_round(file)


def test_late_is_what_was_made_after_the_closing_time() -> None:
    sealed = Round("5" * 64, None, CLOSES)
    assert not sealed.is_late("2027-03-01T17:00:00+00:00")
    assert sealed.is_late("2027-03-01T17:00:01+00:00")
    assert not sealed.is_late("2027-03-01T17:30:00+02:00")
    assert sealed.is_late("2027-03-01T16:00:00"), "a time without its zone tells nothing"
    assert sealed.is_late("yesterday")
    assert not SECRET.is_late("2999-01-01T00:00:00+00:00")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("2999-03-01T18:00", "time zone"),
        ("2999-03-01", "time zone"),
        ("next week", "time zone"),
        ("1" * 5000, "time zone"),
        ("2020-03-01T18:00+01:00", "is in the past"),
    ],
)
def test_a_closing_time_has_its_zone_and_is_to_come(glbench: Command, tmp_path: Path, given: str, words: str) -> None:
    answer = glbench("round", "new", tmp_path / "r.toml", "--closes", given)
    assert answer.code == 1
    assert words in answer.err
    assert not (tmp_path / "r.toml").exists()


@pytest.mark.parametrize("closes", ["2027-03-01T17:00:00", "2027-03-01", "1", '"soon"', "2027-03-01T17:00:00.5Z", "9" * 5000])
def test_a_file_with_another_closing_time_is_refused(tmp_path: Path, closes: str) -> None:
    file = tmp_path / "r.toml"
    write_round(SECRET, file)
    file.write_text(file.read_text(encoding="utf-8") + f"closes = {closes}\n", encoding="utf-8")
    with pytest.raises(GlbenchError, match=r"r\.toml"):
        read_round(file)


def test_new_and_check_say_until_when_a_round_is_open(glbench: Command, tmp_path: Path) -> None:
    file = tmp_path / "r.toml"
    made = glbench("round", "new", file, "--closes", "2999-03-01T18:00+01:00")
    assert "closes at 2999-03-01 17:00:00 UTC" in made.err
    assert "The round is open: it closes at 2999-03-01 17:00:00 UTC." in glbench("round", "check", file).err
    over = tmp_path / "over.toml"
    write_round(Round("5" * 64, None, CLOSES.replace(year=2020)), over)
    assert "The round is closed: it closed at 2020-03-01 17:00:00 UTC." in glbench("round", "check", over).err
    old = tmp_path / "old.toml"
    assert "never closes" in glbench("round", "new", old).err
    assert "It has no closing time." in glbench("round", "check", old).err


@pytest.mark.slow
def test_after_it_closed_an_entry_is_refused_or_named_as_late(glbench: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    tiny = write_tiny(folder)
    over = tmp_path / "secret" / "over.toml"
    write_round(Round("5" * 64, None, CLOSES.replace(year=2020)), over)
    line = ("evaluate", "rule_based", "--task", tiny, "--round", over, "--episodes", "none")
    refused = glbench(*line)
    assert refused.code == 1
    assert "closed at 2020-03-01 17:00:00 UTC" in refused.err
    assert "--late" in refused.err
    assert not Path("reports").exists()
    late = glbench(*line, "--late")
    assert late.code == 0, late.err
    assert "A result made now is late" in late.err
    (out,) = Path("reports/rounds").iterdir()
    words = "rule_based is late: its result states that it was made at 20"
    board = glbench("leaderboard", "--out", out, "--round", over, "--write")
    assert words in " ".join(board.err.split()) + " ".join(board.out.split())
    assert words in (out / "leaderboard.md").read_text(encoding="utf-8")
    assert "is late" not in glbench("leaderboard", "--out", out).err
    verified = glbench("verify", out / "results", "--round", over)
    assert verified.code == 0, verified.err
    assert "is late" in verified.err


@pytest.mark.parametrize("written", ["9999-12-31T23:59:59-14:00", "0001-01-01T00:00:00+14:00"])
def test_a_closing_time_that_utc_does_not_have_is_refused(written: str) -> None:
    with pytest.raises(GlbenchError, match="whole seconds and a year from 2 to 9998"):
        Round.new(closes=dt.datetime.fromisoformat(written))
