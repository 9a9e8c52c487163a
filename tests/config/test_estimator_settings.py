"""What the estimators' settings take: only keys that have an effect, within bounds that the numerics hold."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from candaemon.config.estimators import CaEstimatorSettings, EstimatorSettings, SwitchingEstimatorSettings
from candaemon.config.gnss import SwitchingFilterSettings
from candaemon.tracking.estimator_factory import make_estimator

ADAPTER: TypeAdapter[EstimatorSettings] = TypeAdapter(EstimatorSettings)
KEYS = ("first_acceleration", "first_turn_rate", "first_jerk")
EFFECTIVE: dict[str, tuple[str, ...]] = {
    "cv": (),
    "ca": ("first_acceleration",),
    "jerk": ("first_acceleration", "first_jerk"),
    "singer": ("first_acceleration",),
    "ct": ("first_turn_rate",),
    "cs": ("first_acceleration",),
    "switching": ("first_acceleration",),
    "imm": KEYS,
    "information": KEYS,
    "federated": KEYS,
    "mlkf": ("first_acceleration",),
}


def told(kind: str, **more: Any) -> EstimatorSettings:
    noise = {"noise": 1.0} if kind in ("cv", "ca", "jerk") else {}
    return ADAPTER.validate_python({"kind": kind} | noise | more)


@pytest.mark.parametrize("kind", EFFECTIVE)
def test_a_first_deviation_belongs_to_estimators_that_have_what_deviates(kind: str) -> None:
    for key in KEYS:
        if key in EFFECTIVE[kind]:
            settings = told(kind, **{key: 0.7})
            assert getattr(settings, key) == 0.7
            make_estimator(settings)
        else:
            with pytest.raises(ValidationError, match="Extra inputs are not permitted"):
                told(kind, **{key: 0.7})


@pytest.mark.parametrize(("key", "column"), [("first_acceleration", 4), ("first_turn_rate", 6), ("first_jerk", 7)])
def test_a_first_deviation_is_that_of_the_first_covariance(key: str, column: int) -> None:
    for kind in ("ca", "jerk", "singer", "ct", "cs", "mlkf"):
        if key in EFFECTIVE[kind]:
            bank, one = make_estimator(told(kind, **{key: 0.7})), np.eye(2)[None]
            bank.spawn(np.zeros((1, 2)), one, np.zeros((1, 2)), one)
            assert bank.covariance[0, 0, column, column] == pytest.approx(0.49)


def test_one_number_stands_for_along_and_across_and_true_for_none() -> None:
    settings = told("ca", noise=2, settling=3)
    assert isinstance(settings, CaEstimatorSettings)
    assert (settings.noise.along, settings.noise.across) == (2.0, 2.0)
    assert settings.settling is not None
    assert (settings.settling.along, settings.settling.across) == (3.0, 3.0)
    for wrong in ({"noise": True}, {"noise": {"along": True, "across": 1.0}}, {"settling": True}, {"wander": False}):
        with pytest.raises(ValidationError, match="valid number"):
            told("ca", **wrong)


@pytest.mark.parametrize(
    ("settling", "valid"), [(0, True), (0.02, True), (1e4, True), (0.019, False), (1e-300, False), (1.1e4, False)]
)
def test_a_time_constant_is_none_or_one_that_a_vehicle_may_have(settling: float, valid: bool) -> None:
    if valid:
        make_estimator(told("ca", settling={"along": settling, "across": 1.0}))
        return
    with pytest.raises(ValidationError, match=r"settling\.(Settling)?"):
        told("ca", settling={"along": settling, "across": 1.0})


def test_switching_has_the_same_names_and_bounds_for_own_track_and_obstacles() -> None:
    own, obstacles = (
        settings.model_json_schema()["properties"] for settings in (SwitchingFilterSettings, SwitchingEstimatorSettings)
    )
    assert set(obstacles) - set(own) == {"measurement_noise"}
    for name, told_of in own.items():
        if name != "first_acceleration":
            assert {**told_of, "default": None} == {**obstacles[name], "default": None}, name
