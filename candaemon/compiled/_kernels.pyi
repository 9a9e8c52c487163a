from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from candaemon.arrays import Booleans, Bytes, ComplexPlane, Floats, Indices, Integers
from candaemon.estimation.measurement import Projection

REVISION: Final[int]
_Heard: TypeAlias = tuple[float, int, int] | None
_Bias: TypeAlias = tuple[float | None, float, float, float, float, float, float]
_InsMemory: TypeAlias = tuple[int, bool, float | None, int, float, int, float, float, float, _Bias]
_SampleT = TypeVar("_SampleT", bound=tuple[Any, ...])

def halved(covariance: Floats) -> None: ...
def update_position(mean: Floats, covariance: Floats, position: Floats, noise: Floats) -> tuple[Floats, Floats]: ...
def update_scalar(
    mean: Floats, covariance: Floats, row: Floats, innovation: Floats, variance: Floats
) -> tuple[Floats, Floats]: ...
def drive_axes(columns: Floats, limit: float, floor: float) -> None: ...
def update_axes(state: Floats, size: int, position: Floats, variance: Floats, left: float) -> tuple[Floats, Floats]: ...
def predict_plane(columns: Floats, axis: Floats, adapts: bool, limit: float, floor: float) -> None: ...
def update_plane(
    columns: Floats,
    rows: Indices,
    position: Floats,
    noise: Floats,
    rate: Floats | None,
    variance: Floats | None,
    x0: float,
    y0: float,
    vx0: float,
    vy0: float,
) -> Floats: ...
def take_speed(columns: Floats, rows: Indices, row: Floats, innovation: Floats, variance: Floats) -> Floats: ...
def plane_moments(columns: Floats) -> tuple[Floats, Floats]: ...
def interact(
    mean: Floats, covariance: Floats, probability: Floats, switch: Floats, has: Booleans, source: Indices
) -> None: ...
def update_models(
    mean: Floats,
    covariance: Floats,
    has: Booleans,
    rows: Indices,
    position: Floats,
    noise: Floats,
    rate: Floats | None,
    variance: Floats | None,
    x0: float,
    y0: float,
    vx0: float,
    vy0: float,
) -> tuple[Floats, Floats]: ...
def fits(nis: Floats, log_root: Floats, log_2_pi: float, least: float) -> tuple[Floats, Floats]: ...
def weigh(probability: Floats, rows: Indices, likelihood: Floats, nis: Floats, least: float) -> Floats: ...
def propagate(covariance: Floats, transition: Floats, noise: Floats) -> None: ...
def moved(mean: Floats, transition: Floats) -> Floats: ...
def coordinated_turn(mean: Floats, dt: float, rate: Floats, sine: Floats, cosine: Floats) -> tuple[Floats, Floats]: ...
def line_of_sight(mean: Floats, x0: float, y0: float, vx0: float, vy0: float) -> tuple[Floats, Floats]: ...
def combined(probability: Floats, mean: Floats, covariance: Floats, turning: Booleans) -> tuple[Floats, Floats]: ...
def pair_nis(
    mean: Floats,
    covariance: Floats,
    position: Floats,
    noise: Floats,
    predicted_rate: Floats,
    row: Floats,
    rate: Floats,
    variance: Floats,
) -> Floats: ...
def vehicle_axes(
    state: Floats,
    covariance: Floats,
    direction: Floats,
    forward: Floats,
    east: float,
    north: float,
    c: float,
    s: float,
    least_square: float,
) -> tuple[Floats, Floats]: ...
def expect_detections(history: Integers, scans: Integers, sensors: Integers, sensor: int, most: int) -> None: ...
def record_detections(
    tracks: Indices,
    rows: Indices,
    object_id: Integers,
    known_id: Integers,
    known_sensor: Integers,
    obstacle: Integers,
    reflection_ns: Integers,
    obstacle_ns: Integers,
    history: Integers,
    sensors: Integers,
    sensor: int,
    time_ns: int,
) -> int: ...
def lives(
    first_ns: Integers,
    last_ns: Integers,
    history: Integers,
    scans: Integers,
    confirmed: Booleans,
    time_ns: int,
    slack_ns: int,
    length: int,
) -> tuple[NDArray[np.int8], Floats, Floats]: ...
def in_order(rows: Indices) -> bool: ...
def turned_towards(
    direction: Floats, forward: Floats, velocity: Floats, min_speed: float, share: float
) -> tuple[Floats, Floats]: ...
def power_series(coefficients: Floats, x: float) -> Floats: ...
def directed_matrices(along: Floats, across: Floats, direction: Floats, width: int) -> Floats: ...
def axis_elements(
    coefficients: Floats, exponent: Indices, dt: float, rate: float, intensity: float, mean_decays: bool
) -> Floats: ...
def polar_points(
    distance: Floats, cosine: Floats, sine: Floats, range_variance: float, angle_variance: float
) -> tuple[Floats, Floats]: ...
def placed(
    offset: Floats, origin: Floats, east: float, north: float, c: float, s: float
) -> tuple[Floats, Floats, Floats]: ...
def number_text(values: Floats, decimals: int) -> bytes: ...
def joined_lines(start: bytes, parts: list[bytes], count: int) -> bytes: ...
def frame_lines(stamp: bytes, payloads: list[tuple[int, bytes]], fd_ids: AbstractSet[int], extended: int) -> bytes: ...
def table_lines(stamp: bytes, can_id: Integers, payload: Bytes, extended: int) -> bytes: ...
def frame_fields(
    text: bytes,
    starts: Integers,
    first: bytes,
    seconds: tuple[int, int],
    fraction: tuple[int, int],
    identifier: tuple[int, int],
    data: tuple[int, int],
) -> tuple[Booleans, Integers, Bytes, Booleans]: ...
def near_pairs(x: Floats, y: Floats, reach: float) -> tuple[Indices, Indices]: ...
def last_rows(known: Integers, wanted: Integers) -> Indices: ...
def duplicated(x: Floats, y: Floats, vx: Floats, along: float, across: float, speed: float) -> Booleans: ...
def mix_bodies(
    mean: Floats,
    covariance: Floats,
    probability: Floats,
    leave: Floats,
    dwell: Floats,
    others: Floats,
    moves: Floats,
    begins: Floats,
    hidden: Floats,
    stoppable: float,
    least: float,
    slow: float,
    sharpest: float,
    least_turning: float,
) -> Floats: ...
def step_bodies(
    mean: Floats,
    covariance: Floats,
    turned: Floats,
    modes: Floats,
    decay: Floats,
    drive: Floats,
    axis: Floats,
    walk: Floats,
    hidden: Floats,
    fade: Floats,
    settling: Floats | None,
    gain: Floats | None,
    dt: float,
    slow: float,
    turn_rate: float,
    least_turning: float,
) -> None: ...
def combine_bodies(probability: Floats, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]: ...
def moments_of_bodies(
    probability: Floats, mean: Floats, covariance: Floats
) -> tuple[Floats, Floats, Floats, Floats]: ...
def motion_of_bodies(mean: Floats, slow: float) -> Floats: ...
def update_bodies(
    mean: Floats,
    covariance: Floats,
    probability: Floats,
    rows: Indices,
    position: Floats,
    noise: Floats,
    rates: object,
    projections: Sequence[object],
    moves: Floats,
    least_information: float,
    evidence: float,
    unmeasured: float,
    least_probability: float,
) -> Floats: ...
def to_travel_axes(vectors: Floats, direction: Floats) -> Floats: ...
def from_travel_axes(components: Floats, direction: Floats) -> Floats: ...
def facing_points(observer: Floats, half_length: Floats, half_width: Floats, rounds: int, least: float) -> Floats: ...
def expected_places(
    mean: Floats, axis: Floats, cosine: Floats, sine: Floats, across: Floats, fade: Floats, horizon: Floats
) -> Floats: ...
def hidden_motion(
    surely: Floats,
    seen_by: Integers,
    leader: Integers,
    mean: Floats,
    drift: Floats,
    axis: Floats,
    drifting: float,
    crossing: float,
) -> tuple[Floats, Floats | None]: ...
def facing_offsets(
    mean: Floats,
    facing: Floats,
    axis: Floats,
    length: Floats,
    width: Floats,
    east: float,
    north: float,
    rounds: int,
    least: float,
) -> Floats: ...
def speeds_of_slides(
    mean: Floats,
    facing: Floats,
    axis: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    extent: Floats,
    confirmed: Booleans,
    directed: Booleans,
    last_ns: Integers,
    body: Indices,
    reflection_ns: Integers,
    east: float,
    north: float,
    own_east: float,
    own_north: float,
    rounds: int,
    least: float,
    told_length: float,
    small: float,
    enough: float,
    truck_length: float,
    beside: float,
    step: float,
) -> Floats | None: ...
def slide_references(
    mean: Floats,
    facing: Floats,
    axis: Floats,
    cosine: Floats,
    sine: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    extent: Floats,
    alone: Floats,
    directed: Booleans,
    body: Integers,
    offset: Floats,
    east: float,
    north: float,
    own_east: float,
    own_north: float,
    rounds: int,
    least: float,
    told_length: float,
    small: float,
    enough: float,
    turn_error: float,
) -> Floats | None: ...
def reflections_to_split(
    offset: Floats,
    rate_difference: Floats,
    body: Indices,
    leader: Integers,
    mean: Floats,
    directed: Booleans,
    fastest: Floats,
    along: float,
    extent: float,
    across: float,
    around: float,
    speed: float,
    slow: float,
    moved: float,
) -> Booleans | None: ...
def mark_detected(
    row: Indices,
    body: Indices,
    keys: Integers | None,
    sensor_of: Integers,
    object_id: Integers,
    reflection_last_ns: Integers,
    history: Integers,
    sensors: Integers,
    sensor: int,
    time_ns: int,
) -> list[int]: ...
def turn_axes_of_bodies(
    mean: Floats,
    covariance: Floats,
    axis: Floats,
    directed: Booleans,
    ahead: Floats,
    part: Floats,
    passed: Floats,
    facing: Floats,
    turn: Floats | None,
    turn_variance: Floats | None,
    pivot: Floats | None,
    course_error: float,
    backing: float,
    forgetting: float,
    leads: float,
    sideways: float,
    telling: float,
    unknown: float,
    doubt: float,
    unsure: float,
    least_turn: float,
    wrong: float,
    tightest: Floats,
) -> tuple[Floats, Booleans | None]: ...
def bodies_to_merge(
    shown: Floats,
    spread: Floats,
    mean: Floats,
    axis: Floats,
    facing: Floats,
    length: Floats,
    width: Floats,
    confirmed: Booleans,
    directed: Booleans,
    last_ns: Integers,
    first_ns: Integers,
    length_variance: Floats,
    grown: Floats,
    alone: Floats,
    fastest: Floats,
    body: Integers,
    seen_ns: Integers,
    offset: Floats,
    time_ns: int,
    stood_ns: int,
    since_ns: int,
    begun_ns: int,
    fresh_ns: int,
    late_ns: int,
    slow: float,
    moved: float,
    apart: float,
    standing_extent: float,
    along: float,
    across: float,
    speed: float,
    deviations: float,
    merge_time: float,
    following: float,
    following_gap: float,
    beside: float,
    following_speed: float,
    extent: float,
    edge: float,
    walker: tuple[float, float],
    narrow: float,
    rider: tuple[float, float],
    rider_fastest: float,
    told_length: float,
    small: float,
    enough: float,
    course_speed: float,
    course_along: float,
    course_across: float,
    course_apart: float,
    course_faster: float,
    course_drift: float,
    course_time: float,
    clear: float,
) -> tuple[Integers, Floats]: ...
def beyond_bodies(
    mean: Floats,
    axis: Floats,
    facing: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    extent: Floats,
    directed: Booleans,
    told_length: float,
    small: float,
    enough: float,
    margin: float,
) -> tuple[Floats, bool]: ...
def reference_targets(
    body: Integers,
    last_ns: Integers,
    offset: Floats,
    facing: Floats,
    axis: Floats,
    length: Floats,
    width: Floats,
    fastest: Floats,
    since_ns: int,
    course_speed: float,
    least_normal: float,
) -> Floats: ...
def measure_bodies(
    body: Indices, position: Floats, noise: Floats, offset: Floats, spread: Floats, least: float
) -> tuple[Indices, Indices, Indices, Floats, Floats]: ...
def note_rates(
    noted: Floats,
    row: Indices,
    body: Indices,
    shown: Floats,
    offset: Floats,
    measured: Floats,
    x0: float,
    y0: float,
    vx0: float,
    vy0: float,
    share: Floats,
    turn: Floats | None,
    pivot: Floats | None,
) -> None: ...
def apart_from_most(
    body: Indices,
    fastest: Floats,
    shown: Floats,
    position: Floats,
    range_rate: Floats | None,
    x0: float,
    y0: float,
    vx0: float,
    vy0: float,
    projections: tuple[Projection, ...],
    turn: Floats | None,
    pivot: Floats | None,
    fewest: int,
    slowest: float,
    most: float,
) -> list[int]: ...
def learn_offsets(
    offset: Floats,
    variance: Floats,
    row: Indices,
    body: Integers,
    position: Floats,
    noise: Floats,
    shown: Floats,
    before: Floats,
    axis: Floats,
) -> None: ...
def note_strays(
    trail: Floats,
    walked: Floats,
    stood: Floats,
    trail_ns: Integers,
    last_ns: Integers,
    row: Indices,
    body: Integers,
    position: Floats,
    noise: Floats,
    length: Floats,
    dt: Floats,
    keep: Floats,
    lost: Booleans,
    time_ns: int,
    sensor_x: float,
    sensor_y: float,
    own_vx: float,
    own_vy: float,
    slow: float,
    distance: float,
    deviations: float,
    memory_cubed: float,
    surely: float,
    jump: float,
    least_jump: float,
    walking: float,
    running: float,
    still: float,
    perhaps: float,
    longest: float,
    nearest: float,
) -> None: ...
def drive_on(
    stood: Floats,
    row: Indices,
    position: Floats,
    range_rate: Floats | None,
    rate_variance: Floats | None,
    projections: tuple[Projection, ...],
    sensor_x: float,
    sensor_y: float,
    own_vx: float,
    own_vy: float,
    slow: float,
    surely: float,
    nearest: float,
) -> None: ...
def strays(
    walked: Floats,
    stood: Floats,
    body: Integers,
    last_ns: Integers,
    leader: Integers,
    body_fastest: Floats,
    axis: Floats,
    trail: Floats,
    mean: Floats,
    slow: float,
    still: float,
    fastest: float,
    far: float,
    since_ns: int,
    time_ns: int,
) -> Indices | None: ...
def factors_of_scans(interval: Floats, body: Indices, cycle_time: float, by_scans: Floats) -> Floats: ...
def note_innovations(
    innovation: Floats,
    row: Indices,
    body: Integers,
    seen_by: Integers,
    last_ns: Integers,
    leader: Integers,
    confirmed: Booleans,
    first_ns: Integers,
    shown: Floats,
    position: Floats,
    noise: Floats,
    sensor: int,
    since_ns: int,
    born_ns: int,
    most: float,
    unused: float,
) -> tuple[float, float]: ...
def note_sizes(
    alone: Floats,
    fastest: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    width_variance: Floats,
    first_ns: Integers,
    mean: Floats,
    body: Indices,
    rows: Integers,
    position: Floats,
    origin: Floats,
    own: Floats,
    interval: Floats,
    in_sight: Floats,
    time_ns: int,
    near: float,
    alone_time: float,
    faster_share: float,
    crossing_share: float,
    crossing: float,
    wholly: float,
    never: float,
    age: float,
    told: float,
    moved: float,
    walking: float,
    riding: float,
    pace: float,
    pace_time: float,
    walker: tuple[float, float],
    rider: tuple[float, float],
) -> None: ...
def grow_boxes(
    length: Floats,
    width: Floats,
    extent: Floats,
    length_variance: Floats,
    width_variance: Floats,
    first_ns: Integers,
    passed: Floats,
    share: Floats,
    mean: Floats,
    body: Integers,
    seen_by: Integers,
    last_ns: Integers,
    offset: Floats,
    time_ns: int,
    sensor: int,
    since_ns: int,
    shrinkage_time: float,
    car_length: float,
    axis_speed: float,
    age: float,
    margin: float,
    truck_length: float,
    told: float,
    truck_width: float,
    enough: float,
    car_width: float,
) -> None: ...
def sight_lines(
    centre: Floats,
    reference: Floats,
    axis: Floats,
    length: Floats,
    width: Floats,
    mount_x: float,
    mount_y: float,
    least: float,
    point: float,
) -> Floats: ...
def shares_in_sight(
    bearing: Floats,
    angle: Floats,
    away: Floats,
    distance: Floats,
    yaw: float,
    opening: float,
    least_range: float,
    most_range: float,
    behind: bool,
    margin: float,
    range_margin: float,
    half_turn: float,
) -> Floats: ...
def boxes_in_vehicle_axes(
    mean: Floats,
    facing: Floats,
    axis: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    fastest: Floats,
    confirmed: Booleans,
    standing: Floats,
    east: float,
    north: float,
    c: float,
    s: float,
    surely: float,
    moved: float,
    post: float,
) -> tuple[Floats, Floats]: ...
def detection_probabilities(
    share: Floats,
    distance: Floats,
    missed: Booleans,
    detected: Floats,
    expected: Floats,
    prior: Floats,
    weight: float,
    part: float,
    least: float,
    most: float,
) -> Floats: ...
def learn_rates(expected: Floats, detected: Floats, counts: Floats, fading: Floats, most: float) -> None: ...
def likelihood_ratios(
    spread: Floats,
    variance: Floats,
    noise: Floats,
    body: Indices,
    reflection: Indices,
    fit: Floats,
    scale: float,
) -> tuple[Booleans, Floats]: ...
def states_of_reflections(
    shown: Floats,
    spread: Floats,
    body: Integers,
    offset: Floats,
    variance: Floats,
    axis: Floats,
    turn: Floats | None,
    pivot: Floats | None,
) -> tuple[Floats, Floats]: ...
def turning_of_bodies(
    probability: Floats,
    mean: Floats,
    covariance: Floats,
    overall: Floats,
    facing: Floats,
    length: Floats,
    length_variance: Floats,
    extent: Floats,
    alone: Floats,
    directed: Booleans,
    told_length: float,
    small: float,
    enough: float,
) -> tuple[Floats, Floats, Floats] | None: ...
def swing_of_bodies(
    overall: Floats, standing: Floats, rate: Floats, variance: Floats, pivot: Floats
) -> tuple[Floats, Floats] | None: ...
def weigh_existence(
    existence: Floats,
    in_sight: Floats,
    unseen: Floats,
    confirmed: Booleans,
    seen: Booleans,
    expected: Booleans,
    share: Floats,
    detection: Floats,
    likelihood: Floats,
    limit: float,
    careful: float,
    most: float,
    first: float,
    least: float,
    largest: float,
) -> None: ...
def opportunities(
    share: Floats,
    distance: Floats,
    seen: Booleans,
    missed: Booleans,
    counts: Booleans,
    clear: float,
    part: float,
    parts: int,
) -> Floats: ...
def report_bodies(
    mean: Floats,
    covariance: Floats,
    standing: Floats,
    turn: Floats | None,
    turn_variance: Floats | None,
    pivot: Floats | None,
    axis: Floats,
    facing: Floats,
    length: Floats,
    width: Floats,
    length_variance: Floats,
    extent: Floats,
    alone: Floats,
    fastest: Floats,
    first_ns: Integers,
    last_ns: Integers,
    confirmed: Booleans,
    own: Floats,
    east: float,
    north: float,
    c: float,
    s: float,
    time_ns: int,
    slack_ns: int,
    wander_time: float,
    slow_course: float,
    close: float,
    small_place: float,
    place: float,
    large_place: float,
    anywhere: float,
    surely: float,
    settled: float,
    slow: float,
    told_length: float,
    small: float,
    enough: float,
    narrow: float,
    truck_length: float,
    walking: float,
) -> tuple[Floats, NDArray[np.int8], Floats]: ...
def fit_reflections(
    rows: Indices,
    new: Booleans,
    vague: Booleans,
    body: Integers,
    shown: Floats,
    spread: Floats,
    offset: Floats,
    variance: Floats,
    axis: Floats,
    confirmed: Booleans,
    position: Floats,
    noise: Floats,
    rate: Floats,
    rate_variance: Floats,
    x0: float,
    y0: float,
    vx0: float,
    vy0: float,
    confirmed_gate: float,
    gate: float,
    turn: Floats | None,
    pivot: Floats | None,
) -> tuple[Indices, Floats, int]: ...
def longer_ago(last_ns: Integers, time_ns: int, longest: float) -> Booleans | None: ...
def bodies_to_forget(
    first_ns: Integers,
    last_ns: Integers,
    confirmed: Booleans,
    covariance: Floats,
    time_ns: int,
    coast: float,
    longest: float,
    uncertainty: float,
) -> Booleans | None: ...
def bodies_to_confirm(
    existence: Floats, last_ns: Integers, confirmed: Booleans, time_ns: int, sure: float
) -> list[int]: ...
def let_time_pass(
    existence: Floats, unseen: Floats, in_sight: Floats, kept: float, dt: float, least: float
) -> None: ...
def note_detections(interval: Floats, last_ns: Integers, body: Indices, time_ns: int, longest: float) -> None: ...
def experience_of_bodies(
    sensors: Integers,
    history: Integers,
    existence: Floats,
    confirmed: Booleans,
    seen: Booleans,
    sensor: int,
    sure: float,
) -> tuple[Booleans, Booleans, Indices]: ...
def hand_over(leader: Integers, body: Integers, last_ns: Integers, time_ns: int, patience_ns: int) -> None: ...
def stay_alongside(alongside_ns: Integers, older: Integers, needed: Floats, dt_ns: int) -> list[int]: ...
def return_exponents(
    first_ns: Integers, last_ns: Integers, interval: Floats, time_ns: int, longest: float, least: float
) -> Floats: ...
def step_references(body: Integers, offset: Floats, target: Floats, left: Floats, axis: Floats) -> Floats: ...
def follow_biases(
    drift: Floats,
    axis: Floats,
    beyond: Floats,
    dt: Floats,
    near: Floats,
    share: Floats,
    least_time: float,
    least_drift: float,
    opening_time: float,
) -> tuple[Floats, Floats]: ...
def settle_bodies(mean: Floats, covariance: Floats, moves: Floats, step: Floats, spread: Floats | None) -> None: ...
def shift_bodies(mean: Floats, overall: Floats, shown: Floats, step: Floats) -> None: ...
def standing_reflections(
    velocity: Floats,
    sight: Floats,
    distance: Floats,
    body: Indices,
    confirmed: Booleans,
    radial: float,
    any_way: float,
) -> Booleans: ...
def look_up(table: Indices, ids: Integers) -> tuple[Indices, bool]: ...
def within_field(
    bearing: Floats,
    distance: Floats,
    yaw: float,
    opening: float,
    least_range: float,
    most_range: float,
    half_turn: float,
) -> Booleans: ...
def drive_modes(driven: Floats, standing: Floats, turning: Floats, times: list[float]) -> Floats: ...
def course(
    samples: Sequence[tuple[float, ...]], after: int, begin_ns: int, step_ns: int, count: int, limit_ns: float
) -> tuple[ComplexPlane, Floats] | None: ...
def moments_of_path(
    distance: Floats, heading: Floats, unit: ComplexPlane, t: Floats, scale: float, bias: float, step: float
) -> tuple[ComplexPlane, Floats]: ...
def successions(
    order: Indices,
    object_id: Integers,
    new: Booleans,
    scan: Indices,
    since: Floats,
    place: ComplexPlane,
    jump: float,
    longest_gap: float,
) -> tuple[Indices, Indices]: ...

class InsEpochs:
    def __init__(self, roles: tuple[int, ...], waits: int, limits: tuple[float, ...]) -> None: ...
    def keep(self, times: Integers, message: Indices, values: Floats, columns: Indices) -> None: ...
    def load(self, signals: Sequence[_Heard], waiting: int, memory: _InsMemory, last: tuple[float, ...]) -> None: ...
    def memory(self) -> tuple[list[_Heard], int, _InsMemory, tuple[int, int, int, int]]: ...
    def take(self, begin: int, end: int, kind: type[_SampleT]) -> tuple[int, list[_SampleT]]: ...

def offsets_of_reflections(offset: Floats, axis: Floats, body: Integers, rows: Integers) -> Floats: ...
def arms_of_reflections(shown: Floats, offset: Floats, body: Integers, pivot: Floats, variance: Floats) -> Floats: ...
def sure_swings(
    mean: Floats,
    standing: Floats,
    rate: Floats,
    variance: Floats,
    pivot: Floats,
    deviations: float,
    dt: float,
) -> Floats | None: ...
def lies_far_along(
    offset: Floats,
    body: Integers,
    confirmed: Booleans,
    directed: Booleans,
    fastest: Floats,
    slower: float,
    far: float,
) -> bool: ...
def widest_across(offset: Floats) -> float: ...
def turns_of_modes(mean: Floats, drive: Floats, component: int, time: int, most: float) -> Floats: ...
def loosen_offsets(variance: Floats, leader: Integers, kept: float, added: float) -> None: ...
def steps_of_trails(
    trail_ns: Integers,
    rows: Integers,
    body: Integers,
    fastest: Floats,
    time_ns: int,
    walking: float,
    patience: float,
    patience_with_vehicles: float,
    least: float,
) -> tuple[Floats, Booleans]: ...
def detected_after(interval: Floats, last_ns: Integers, time_ns: int) -> Floats: ...
def scaled_noise(noise: Floats, factor: Floats) -> Floats: ...
def possible_sizes(values: Floats, row: int, most: float) -> tuple[Floats | None, int]: ...
