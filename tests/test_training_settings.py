"""Settings given as text."""

import dataclasses

import pytest

from geort_drake.errors import GeortError
from geort_drake.settings import parse_settings


@dataclasses.dataclass
class Config:
    steps: int = 10
    rate: float = 0.5
    exact: bool = True
    mode: str = "slow"
    extent: tuple = (1, 2)


def test_values_get_the_type_of_the_default():
    """Numbers, truth values and texts, also those with an equals sign; the last of a name counts."""
    texts = ["steps=20", "rate=1e-3", "exact=False", "mode=a=b", "steps=30"]
    assert parse_settings(texts, Config, "x") == {"steps": 30, "rate": 1e-3, "exact": False, "mode": "a=b"}
    assert parse_settings([], Config(), "x") == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("steps", "setting of the toy is given as NAME=VALUE, not as 'steps'"),
        ("steps=1.5", "must be int, not '1.5'"),
        ("exact=1", "must be true or false, not '1'"),
        ("extent=3", "unknown setting of the toy 'extent'; choose one of: exact, mode, rate, steps"),
    ],
)
def test_what_is_no_setting_is_refused(text, message):
    """Form, type and name, each with what was expected."""
    with pytest.raises(GeortError, match=message):
        parse_settings([text], Config, "the toy")
