"""A campaign's table is true to its schema, or the column that is not is named."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from testbed.campaigns.campaign import Campaign
from testbed.campaigns.conduct import conduct
from testbed.campaigns.summary import changes, read_campaign, summarise, write_summary
from testbed.core.base.errors import TestbedError
from tests.helpers.campaigns import NOISES, Odd, campaign_file

FAULTY: dict[str, list[Any]] = {
    "status": ["perhaps"],
    "cell": [1.5],
    "factor/noise": [float("nan"), None],
    "external/names": [["a"], [None, None]],
    "external/truth": [[1.0], [1.0, None], [1.0, float("inf")]],
    "external/values": [[float("nan"), 1.0]],
    "external/sigma": [[-1.0, 1.0], [float("nan"), 1.0]],
    "external/relative_error": [[1.0]],
}
"""Values that no campaign writes, by column."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("campaign")
    conduct(Campaign.load(campaign_file(place, 3, NOISES)), place / "r", Odd())
    return place


def replaced(table: pa.Table, column: str, values: pa.Array) -> pa.Table:
    return table.set_column(table.schema.get_field_index(column), column, values)


def refusal(place: Path) -> str:
    """Why a campaign cannot be summarised; "" where it can."""
    try:
        found = summarise(read_campaign(place))
    except TestbedError as error:
        return str(error)
    write_summary(found, place)
    list(changes(found, found))
    return ""


def damaged(table: pa.Table) -> Iterator[tuple[str, str, pa.Table]]:
    """Tables with one column that is gone, twice there, of another type, empty or faulty."""
    rows = len(table)
    for name in table.column_names:
        yield name, "gone", table.drop_columns([name])
        yield name, "twice", table.append_column(name, table[name])
        yield name, "empty", replaced(table, name, pa.nulls(rows, table[name].type))
        for other in (["x"] * rows, [float("nan")] * rows, [True] * rows, [{"a": 1}] * rows):
            yield name, str(other[0]), replaced(table, name, pa.array(other))
    for name, faults in FAULTY.items():
        for fault in faults:
            values = [*table[name].to_pylist()[:-1], fault]
            yield name, str(fault), replaced(table, name, pa.array(values))


def test_a_damaged_column_is_named_or_does_not_matter(folder: Path, tmp_path: Path) -> None:
    """In the summary, in a comparison and where the campaign goes on."""
    good = pq.read_table(folder / "r/results.parquet")
    path = tmp_path / "results.parquet"
    harmless = set()
    for name, how, table in damaged(good):
        pq.write_table(table, path)
        if said := refusal(tmp_path):
            assert str(path) in said, (name, how)
            assert name in said, (name, how)
            assert len(said) <= 300 + len(str(path)), (name, how)
            with pytest.raises(TestbedError, match=r"results\.parquet"):
                conduct(Campaign.load(folder / "quick.toml"), tmp_path, Odd())
        else:
            harmless.add((name, how))
    texts = {"run", "error", "command", "factor/noise"}
    others = {(name, how) for name, how in harmless if not (how == "x" and name in texts)}
    assert {how for _, how in others} <= {"empty", "nan"}
    assert {name.partition("/")[0] for name, _ in others} <= {"metric", "internal", "diagnostics"}


def test_what_other_programs_do_to_types_is_undone(folder: Path, tmp_path: Path) -> None:
    """Wider numbers, large text and lists, categories, columns of their own; the numbers stay."""
    good = pq.read_table(folder / "r/results.parquet")
    wide = good
    for name, kind in {
        "cell": pa.int64(),
        "seed": pa.float64(),
        "run": pa.large_string(),
        "external/truth": pa.large_list(pa.float64()),
    }.items():
        wide = replaced(wide, name, wide[name].cast(kind))
    wide = replaced(wide, "status", wide["status"].dictionary_encode())
    wide = wide.append_column("mine", pa.array(["x"] * len(wide)))
    pq.write_table(wide, tmp_path / "results.parquet")
    before, after = (summarise(read_campaign(place)) for place in (folder / "r", tmp_path))
    assert (before.parameters, before.cells) == (after.parameters, after.cells)


def test_metadata_and_bytes_are_damaged_without_a_traceback(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "results.parquet"
    good = pq.read_table(folder / "r/results.parquet")
    for said in (b"", b"[]", b"{", json.dumps({"format": "testbed campaign 1", "columns": [3]})):
        pq.write_table(good.replace_schema_metadata({b"testbed": said}), path)
        with pytest.raises(TestbedError, match=r"results\.parquet"):
            read_campaign(tmp_path)
    content = (folder / "r/results.parquet").read_bytes()
    for at in range(0, len(content), len(content) // 40):
        path.write_bytes(content[:at] + bytes([content[at] ^ 0xFF]) + content[at + 1 :])
        assert str(path) in (refusal(tmp_path) or str(path)), at


def test_what_else_is_in_a_folder_may_be_anything(folder: Path, tmp_path: Path) -> None:
    """A lock of a dead process, a campaign's file that is damaged, recordings that are none."""
    campaign = Campaign.load(folder / "quick.toml")
    for name, content in {
        "lock": b"999999",
        "campaign.toml": b"\xff[",
        "new/x.parquet": b"",
        "": b"",
    }.items():
        conduct(campaign, place := tmp_path / f"of-{name.partition('/')[0]}", Odd())
        whole = (place / "results.parquet").read_bytes()
        if name:
            (place / name).parent.mkdir(exist_ok=True)
            (place / name).write_bytes(content)
        if name.startswith("new"):
            with pytest.raises(TestbedError, match=name):
                conduct(campaign, place, Odd())
        else:
            conduct(campaign, place, Odd())
            assert (place / "results.parquet").read_bytes() == whole
