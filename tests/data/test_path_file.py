"""Paths as CSV: what a file says, everything that can be wrong with one, and that one is read back as it was written."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.findings import DictionaryError
from canopen_data.path_file import Between, read_path, write_path
from canopen_proto.drives.trajectory import PathError, cubic, linear, quintic
from tests.examples import examples

POSITIONS = "time, shoulder, elbow\n0, 0, 10\n0.5, 1.5, 8\n1.5, 1, 9\n"
TIMES, ROWS = [0.0, 0.5, 1.5], [[0.0, 10.0], [1.5, 8.0], [1.0, 9.0]]


def test_positions_are_a_spline_or_lines() -> None:
    read = read_path(POSITIONS)
    assert read.joints == ("shoulder", "elbow")
    assert read.path.segments == cubic(TIMES, ROWS).segments
    assert read_path(POSITIONS, between=Between.LINES).path.segments == linear(TIMES, ROWS).segments


def test_velocities_and_accelerations_are_kept() -> None:
    text = "time,a,a.velocity\n0,0,0\n1,1,3\n"
    assert read_path(text).path.segments == cubic([0.0, 1.0], [[0.0], [1.0]], [[0.0], [3.0]]).segments
    text = "a.velocity,a.acceleration,time,a.position\n0,0,7,0\n3,-1,8,1\n"
    assert read_path(text).path.segments == quintic([0.0, 1.0], [[0.0], [1.0]], [[0.0], [3.0]], [[0.0], [-1.0]]).segments


@pytest.mark.parametrize(
    "text",
    [
        "\ufefftime;elbow;shoulder\r\n0;10;0\r\n0.5;8;1.5\r\n1.5;9;1\r\n",
        '# a comment\n\n"time"\t"shoulder"\t"elbow"\n0\t0\t10\n \n0.5\t1.5\t8e0\n#\n1.5\t+1\t9.\n',
        "time,shoulder.position,elbow\n2,0,10\n2.5,1.5,8\n3.5,1,9",
    ],
)
def test_the_forms_of_a_csv(text: str) -> None:
    read = read_path(text, joints=["shoulder", "elbow"])
    assert read.joints == ("shoulder", "elbow")
    assert read.path.segments == cubic(TIMES, ROWS).segments


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ["there is no header"]),
        ("\n# nothing\n", ["there is no header"]),
        ("time,a\n", ["two rows at least; there are 0"]),
        ("time,a\n0,1\n", ["two rows at least; there are 1"]),
        ("time\n0\n1\n", ["p.csv:1:1: error: there is no column of a joint"]),
        ("t,a\n0,1\n1,2\n", ['p.csv:1:1: error: there is no column "time"']),
        ("time,a,a\n0,1,1\n1,2,2\n", ["p.csv:1:8: error: there is another column 'a'"]),
        ("time,a,time\n0,1,1\n1,2,2\n", ["p.csv:1:8: error: there is another column 'time'"]),
        ("time,,a\n0,1,1\n1,2,2\n", ["p.csv:1:6: error: this column has no name"]),
        ("time,a,b,a.velocity\n0,1,1,1\n1,1,1,1\n", ['there is no column "b.velocity": all joints have the same columns']),
        ("time,a,b.velocity\n0,1,1\n1,1,1\n", ['no column "b"', 'no column "a.velocity"']),
        ("time,a,a.acceleration\n0,1,1\n1,1,1\n", ['there is no column "a.velocity"']),
        (
            "time, a\n0, x\n1, 2, 3\n0.5, nan\n0.5, 1\n2, 1,5\n",
            [
                "p.csv:2:4: error: 'x' is no finite number",
                "p.csv:3:7: error: this row has 3 columns, the header has 2",
                "p.csv:4:6: error: 'nan' is no finite number",
                "p.csv:5:1: error: the times must rise; before this 0.5 comes 0.5",
                "p.csv:6:6: error: this row has 3 columns",
            ],
        ),
        ("time,a\n0,0\n1e-200,1\n", ["p.csv: error: The times of waypoints must rise by 1e-09 s to 1e+15 s"]),
        (
            "time,a\n0,0\n1e-8,1e300\n",
            ["p.csv: error: Row 1 (counted from 0) of the positions has a value that is no finite"],
        ),
    ],
)
def test_everything_wrong_is_told_at_once_with_its_place(text: str, expected: list[str]) -> None:
    with pytest.raises(DictionaryError) as caught:
        read_path(text, "p.csv")
    found = [str(each) for each in caught.value.findings]
    assert len(found) == len(expected)
    assert all(word in each for word, each in zip(expected, found, strict=True)), found


def test_joints_that_are_not_those_of_the_chain() -> None:
    with pytest.raises(DictionaryError) as caught:
        read_path("time,shoulder,elbo\n0,0,0\n1,1,1\n", joints=["shoulder", "elbow"])
    first, second = map(str, caught.value.findings)
    assert "there is no joint 'elbo'; did you mean" in first
    assert 'there is no column "elbow"' in second


value = st.floats(-100, 100)


@given(
    st.lists(st.tuples(st.floats(0.01, 3), st.lists(value, min_size=6, max_size=6)), min_size=2, max_size=6), st.floats(0.02, 1)
)
@examples(30)
def test_a_path_is_read_back_as_it_was_written(points: list[tuple[float, list[float]]], step: float) -> None:
    times = [sum(each for each, _ in points[:number]) for number in range(len(points))]
    path = quintic(times, *([row[order : order + 2] for _, row in points] for order in (0, 2, 4)))
    names, read, _ = read_path(write_path(path, ["left arm", "b.2"], step))
    assert names == ("left arm", "b.2")
    assert read.duration == path.duration
    for number in range(50):
        time = path.duration * number / 49
        for mine, theirs in zip(path.at(time), read.at(time), strict=True):
            assert theirs == pytest.approx(mine, rel=1e-6, abs=1e-3)


def test_knots_and_end_have_rows_of_their_own() -> None:
    text = write_path(linear([0.0, 0.25, 1.0], [[0.0], [1.0], [2.5]]), ["a"], 0.4)
    assert text.splitlines()[0] == "time,a,a.velocity,a.acceleration"
    assert [line.split(",")[0] for line in text.splitlines()[1:]] == ["0.0", "0.25", "0.4", "0.8", "1.0"]


@pytest.mark.parametrize("names", [["a"], ["a", "a"], ["a", "time"], ["a", "b,c"], ["a", ""], ["a", "#b"], ["a", "b.velocity"]])
def test_names_that_would_not_be_read_back(names: list[str]) -> None:
    with pytest.raises(PathError, match="cannot name them 'a'"):
        write_path(linear(TIMES, ROWS), names, 0.1)


@pytest.mark.parametrize("step", [0.0, -1.0, 1e-9, float("nan")])
def test_steps_that_cannot_be(step: float) -> None:
    with pytest.raises(PathError, match="in steps of"):
        write_path(linear(TIMES, ROWS), ["a", "b"], step)
