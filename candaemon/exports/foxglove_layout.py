"""A layout of Foxglove for the topics of a drive: the scene, the map, plots, messages of trouble, frames."""

from __future__ import annotations

from typing import Any, Final

from candaemon.binding.bound import Binding
from candaemon.exports.extras import import_extra
from candaemon.exports.palette import SERIES
from candaemon.exports.scene_messages import LOCAL, VEHICLE
from candaemon.tracking.obstacles import STATE_NAMES

_PLOTS: Final = {
    "Obstacles": {state: f"/cycles.{state}" for state in STATE_NAMES},
    "NIS": {"mean": "/cycles.nis", "expected": "/cycles.nis_expected"},
    "Own motion": {"speed (m/s)": "/cycles.speed", "yaw rate (rad/s)": "/cycles.yaw_rate"},
    "Speed along of the obstacles (m/s)": {"vx": "/obstacles/states.obstacles[:].vx"},
}
"""Curves of each plot by their label."""


def layout(binding: Binding) -> str:
    """Return a layout for the MCAP files of a configuration, as JSON that Foxglove imports.

    Raises:
        ConfigError: foxglove-sdk is not installed.
    """
    form = import_extra("foxglove.layouts", "foxglove", "a layout of Foxglove")
    shown = ["/obstacles", "/own_vehicle", *(f"/detections/{sensor.name}" for sensor in binding.sensors)]
    topics: dict[str, Any] = {topic: form.BaseRendererSceneUpdateTopicSettings(visible=True) for topic in shown[:2]}
    for k, topic in enumerate(shown[2:]):
        topics[topic] = form.BaseRendererPointCloudTopicSettings(
            visible=True, point_size=6, color_mode="flat", flat_color=SERIES[(k + 1) % len(SERIES)]
        )
    scene = form.ThreeDeePanel(
        title="Scene",
        config=form.ThreeDeeConfig(
            follow_tf=VEHICLE,
            fixed_frame=LOCAL,
            follow_mode="follow-pose",
            camera_state=form.ThreeDeeCameraState(
                distance=90.0,
                perspective=False,
                phi=0.0,
                theta_offset=0.0,
                target=(0.0, 0.0, 0.0),
                target_offset=(30.0, 0.0, 0.0),
            ),
            topics=topics,
            layers={"grid": form.BaseRendererGridLayerSettings(visible=True, size=200, divisions=20, frame_id=VEHICLE)},
        ),
    )
    plots = [
        form.PlotPanel(
            title=title,
            config=form.PlotConfig(
                paths=[
                    form.PlotSeries(
                        value=path, label=label, color=SERIES[k % len(SERIES)], timestamp_method="headerStamp"
                    )
                    for k, (label, path) in enumerate(series.items())
                ]
            ),
        )
        for title, series in _PLOTS.items()
    ]
    first = f"/can/{binding.buses[0].name}"
    beside = [
        form.TabContainer(
            tabs=[
                form.TabItem(title="Plots", content=_column(form, plots)),
                form.TabItem(title="Map", content=form.MapPanel(config=form.MapConfig(follow_topic="/location"))),
                form.TabItem(
                    title="Frames",
                    content=form.RawMessagesPanel(config=form.RawMessagesConfig(topic_path=first)),
                ),
            ]
        ),
        form.LogPanel(title="Diagnostics"),
    ]
    whole = form.SplitContainer(
        direction="row",
        items=[
            form.SplitItem(proportion=3, content=scene),
            form.SplitItem(proportion=2, content=_column(form, beside)),
        ],
    )
    text: str = form.Layout(content=whole).to_json()
    return f"{text}\n"


def _column(form: Any, contents: list[Any]) -> Any:
    return form.SplitContainer(direction="column", items=[form.SplitItem(content=each) for each in contents])
