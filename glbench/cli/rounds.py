"""``glbench round``: make and check the secret of a sealed round."""

from __future__ import annotations

import datetime as dt
from pathlib import Path
from typing import Annotated

import typer

from glbench.cli.console import print_warning, put, tell
from glbench.errors import GlbenchError

app = typer.Typer(
    help="Make and check the secret of a sealed round (docs/maintain.md).",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)

File = Annotated[Path, typer.Argument(metavar="FILE", help="The round's file (.toml).")]


@app.command()
def new(
    file: File,
    weather: Annotated[
        str | None,
        typer.Option(
            "--weather", help="Weather record of the round's own, in place of the task's (glbench weather list)."
        ),
    ] = None,
    year: Annotated[
        list[int] | None, typer.Option("--year", help="A whole year of that record to draw from; repeatable.")
    ] = None,
    closes: Annotated[
        str | None,
        typer.Option(
            "--closes", help="Closing time, such as 2027-03-01T18:00+01:00. Results made after it count as late."
        ),
    ] = None,
) -> None:
    """Make the secret of a round, write it to FILE, and print the commitment, which is to be published with the closing time."""
    from glbench.tasks.sealed import Round, closing_time, round_weather, write_round

    if (weather is None) != (not year):
        msg = "Weather of the round's own has a record and years: give --weather NAME and --year YEAR, or neither."
        raise GlbenchError(msg)
    closing = None if closes is None else closing_time(closes)
    sealed = Round.new(None if weather is None else round_weather(weather, year or ()), closing)
    write_round(sealed, file)
    put(sealed.commitment)
    tell(f"{file} is secret until the round is over: keep it, and a copy of it. Publish the commitment above.")
    if closing is None:
        print_warning("This round never closes, so no result can be late. --closes gives it a closing time.")
    else:
        tell(f"The round closes at {sealed.closing_words}. Publish that, too; the commitment covers it.")


@app.command()
def check(
    file: File,
    commitment: Annotated[
        str | None, typer.Argument(metavar="[COMMITMENT]", help="The commitment that was published.")
    ] = None,
) -> None:
    """Check that the secret in FILE fits its commitment, and the one that was published; print the commitment, and say if it is open."""
    from glbench.tasks import read_round

    sealed = read_round(file)
    if commitment is not None and commitment.strip().lower() != sealed.commitment:
        msg = f"{file} opens the commitment {sealed.commitment}, and not {commitment}. It is not the secret of that round."
        raise GlbenchError(msg)
    put(sealed.commitment)
    weather = sealed.weather
    own = "" if weather is None else f" Weather {weather.digest}, years {', '.join(map(str, weather.years))}."
    state = "closed" if sealed.is_late(dt.datetime.now(dt.UTC)) else "open"
    until = (
        " It has no closing time."
        if sealed.closes is None
        else f" The round is {state}: it closes at {sealed.closing_words}."
    )
    tell(f"The secret in {file} fits.{own}{until.replace('it closes', 'it closed') if state == 'closed' else until}")
