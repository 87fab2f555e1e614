"""Times and limits of the loop, with a simulated clock."""

from types import SimpleNamespace

import numpy as np
import pytest
from rig import ARM, DRIVING, WORKSPACE, movement
from test_velocity_loop import ScriptedWire
from test_velocity_loop import driver as arm

from stringcast.hardware.arm import Driving, clock, device, loop
from stringcast.hardware.arm.limits import Workspace, check_movement
from stringcast.hardware.arm.loop import DRAIN_S, Guard, play, reserve_log
from stringcast.pipeline.settings.composition import UserError
from stringcast.pipeline.settings.typed_settings import build_dataclass
from stringcast.stages.execute.interfaces import HardwareError

CLOCK_READ_S = 1e-6  # duration [s] of reading the clock


@pytest.fixture
def now(monkeypatch):
    """Simulate a time [s] that passes only in sleeps and clock readings."""
    time = SimpleNamespace(now=100.0, slept=[])

    def monotonic():
        time.now += CLOCK_READ_S
        return time.now

    def sleep(seconds):
        assert seconds >= 0
        time.slept.append(seconds)
        time.now += seconds

    for module in (loop, clock, device):
        monkeypatch.setattr(
            module, "time", SimpleNamespace(monotonic=monotonic, sleep=sleep)
        )
    return time


class TimedWire(ScriptedWire):
    """A wire that records when each command was sent.

    late: delay of answers by number of the command [s].
    """

    def __init__(self, now, late=lambda number: 0.0):
        super().__init__()
        self.now, self.late, self.at, self.coming = now, late, [], []

    def send(self, speeds):
        self.at.append(self.now.now)
        number, carried = super().send(speeds)
        self.coming += [(self.now.now + self.late(number), self.due.pop())]
        return number, carried

    def answers(self):
        here = [answer for moment, answer in self.coming if moment <= self.now.now]
        self.coming = [
            (moment, answer) for moment, answer in self.coming if moment > self.now.now
        ]
        return here


def guard(misses=4, astray=0.5, pressed=lambda: ""):
    return Guard(ARM, misses, astray, pressed)


def play_speeds(wire, speeds, **how):
    log = reserve_log(np.zeros(3), speeds, ARM.tick)
    play(wire, log, guard(**how), 0)
    return log


def test_ticks_are_sent_at_their_due_times(now):
    wire, begun = TimedWire(now), now.now
    log = play_speeds(wire, np.zeros((10, 3)))
    np.testing.assert_allclose(
        wire.at, begun + (2 + np.arange(10)) * ARM.tick, atol=1e-4
    )
    np.testing.assert_allclose(log.sent, np.arange(10) * ARM.tick, atol=1e-4)
    assert (log.sent >= log.due).all()


def test_late_tick_delays_no_other(now):
    def stall(answer):
        now.now += 0.012 * (answer.number == 3)
        return answer

    wire = TimedWire(now)
    wire.spoil = stall
    log = play_speeds(wire, np.zeros((10, 3)))
    late = log.sent - log.due
    np.testing.assert_allclose(late, [0, 0, 0, 0, 0.007, 0.002, 0, 0, 0, 0], atol=2e-4)


@pytest.mark.parametrize("late", [0.0, 0.003, 0.004, 0.9 * DRAIN_S])
def test_last_answers_are_awaited(now, late):
    log = play_speeds(TimedWire(now, lambda number: late), np.zeros((5, 3)), misses=20)
    took = log.acknowledged - log.sent
    assert (
        (took > late - 1e-9) & (took < late + clock.SPIN_S + loop.POLL_S + 1e-4)
    ).all()


def test_missing_answers_are_awaited_for_a_limited_time(now):
    wire = TimedWire(now, lambda number: np.inf if number > 2 else 0.0)
    log = play_speeds(wire, np.zeros((5, 3)))
    assert list(log.pending_ticks.values()) == [3, 4]
    assert np.isnan(log.acknowledged[3:]).all()
    assert now.now - wire.at[-1] == pytest.approx(DRAIN_S, abs=5e-4)
    # the loop sleeps between polls
    assert now.slept.count(loop.POLL_S) > 0.9 * DRAIN_S / loop.POLL_S
    assert DRAIN_S == 0.05


def test_loop_ends_at_once_after_all_answers(now):
    wire = TimedWire(now)
    play_speeds(wire, np.zeros((5, 3)))
    assert now.now - wire.at[-1] < 5e-4


def test_late_loop_still_reads_answers(now):
    """A late loop must not count an answering device as silent."""

    def stall(answer):
        now.now += 0.02
        return answer

    wire = TimedWire(now)
    wire.spoil = stall
    log = play_speeds(wire, np.zeros((30, 3)), misses=2)
    assert np.isfinite(log.acknowledged).all()


@pytest.mark.parametrize(
    ("speed", "ticks"), [(0.0, 1), (1.5, 1), (1.6, 2), (3.0, 2), (4.6, 4), (-4.6, 4)]
)
def test_ramp_to_rest_follows_the_acceleration_limit(now, speed, ticks):
    """300 rad/s2 in 5 ms are 1.5 rad/s; the fastest joint determines the duration."""
    wire = TimedWire(now)
    wire.spoil = lambda answer: None if answer.number >= 0 else answer
    wire.send = lambda speeds: (
        ScriptedWire.send(wire, speeds),
        wire.at.append(now.now),
    )[0]
    wire.answers = list
    asked = np.tile([0.2 * speed, speed, 0.0], (10, 1))
    with pytest.raises(
        HardwareError,
        match=r"no answer for 5 ticks at 0\.025 s; it was brought to rest",
    ):
        play_speeds(wire, asked)
    ramp = np.array(wire.sent[6:])
    np.testing.assert_allclose(
        ramp, asked[0] * (1 - np.arange(1, ticks + 1)[:, None] / ticks), atol=1e-12
    )
    np.testing.assert_allclose(np.diff(wire.at[5:]), ARM.tick, atol=1e-4)
    assert wire.calls == ["stop"]


def fault_after_turn(leap, between=0.005, **how):
    """Return the guard's reason after joint 3 turns `leap` [rad] in `between` [s]."""
    log = reserve_log(np.zeros(3), np.zeros((4, 3)), ARM.tick)
    log.device_time[:2] = [7.0, 7.0 + between]
    log.angles[:2] = 0.0
    log.last_checked = 0
    log.last_answered = 1
    log.angles[1, 2] = leap
    return guard(**{"astray": 10.0, **how}).stop_reason(log, 2)


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(
    ("between", "most"), [(0.0, 0.22), (0.005, 0.22), (0.010, 0.42), (0.025, 1.02)]
)
def test_encoder_may_turn_at_twice_the_speed_limit_plus_noise(between, most, sign):
    """That is 2 x 20 rad/s times the interval (at least a tick) plus 0.02 rad."""
    assert fault_after_turn(sign * (most - 1e-6), between) == ""
    assert (
        fault_after_turn(sign * (most + 1e-6), between)
        == "the encoder of joint 3 jumped"
    )


@pytest.mark.parametrize("jump", [1, 2, 3])
def test_encoder_jump_is_found_among_simultaneous_answers(jump):
    """After a delay of the computer, several answers arrive in one tick."""
    log = reserve_log(np.zeros(3), np.zeros((5, 3)), ARM.tick)
    log.device_time[:4] = 7.0 + 0.005 * np.arange(4)
    log.angles[:4] = 0.0
    log.last_checked = 0
    log.last_answered = 3
    assert guard(astray=10.0).stop_reason(log, 4) == ""
    log.angles[jump:4, 1] = 0.3
    assert guard(astray=10.0).stop_reason(log, 4) == "the encoder of joint 2 jumped"


def test_joint_may_deviate_up_to_the_limit():
    assert fault_after_turn(0.1, astray=0.1) == ""
    assert (
        fault_after_turn(-0.1000001, astray=0.1)
        == "joint 3 is 0.10 rad from where it was sent"
    )


@pytest.mark.parametrize(
    ("last", "reason"),
    [(3, ""), (2, "no answer for 5 ticks"), (-1, "no answer for 8 ticks")],
)
def test_stated_number_of_ticks_may_stay_unanswered(last, reason):
    log = reserve_log(np.zeros(3), np.zeros((10, 3)), ARM.tick)
    log.last_answered, log.angles[:], log.device_time[:] = last, 0.0, 0.0
    assert guard().stop_reason(log, 8) == reason


def test_unknown_and_duplicate_answers_are_ignored(now):
    wire = TimedWire(now)
    log = play_speeds(wire, np.zeros((5, 3)))
    before = log.acknowledged.copy()
    loop._record_answer(
        log,
        wire.spoil(
            SimpleNamespace(number=2, clock=9.0, hold_reason="", angles=(9.0, 9.0, 9.0))
        ),
    )
    loop._record_answer(
        log,
        SimpleNamespace(number=77, clock=9.0, hold_reason="no", angles=(9.0, 9.0, 9.0)),
    )
    assert (log.acknowledged == before).all()
    assert (log.last_answered, log.hold_reason) == (4, "")


def test_overtaken_answer_is_logged_but_not_the_latest(now):
    log = reserve_log(np.zeros(3), np.zeros((5, 3)), ARM.tick)
    log.pending_ticks = {0: 0, 1: 1, 2: 2}
    for number in (0, 2, 1):
        loop._record_answer(
            log,
            SimpleNamespace(
                number=number,
                clock=0.1 * number,
                hold_reason="",
                angles=(0.1 * number,) * 3,
            ),
        )
    assert log.last_answered == 2
    np.testing.assert_allclose(log.device_time[:3], [0.0, 0.1, 0.2])


# --- the device


class SlowWire(ScriptedWire):
    """A wire with given round-trip times [s]."""

    def __init__(self, now, trips):
        super().__init__()
        self.now, self.trips, self.asked = now, trips, 0

    def angles(self):
        self.now.now += self.trips[self.asked % len(self.trips)]
        self.asked += 1
        return super().angles()


def test_link_test_uses_the_median_of_fifty_round_trips(now):
    for trips, good in (
        ([0.002] * 3, True),
        ([0.001, 0.001, 0.3], True),
        ([0.0021] * 3, False),
    ):
        wire = SlowWire(now, trips)
        link = arm(wire, round_trip=0.002 + 2 * CLOCK_READ_S)
        if good:
            with link:
                np.testing.assert_allclose(
                    np.sort(link.round_trips_s),
                    np.sort(np.resize(trips, 50)),
                    atol=1e-5,
                )
        else:
            calls = r"a round trip takes 2\.1 ms \(99 %: 2\.1, longest: 2\.1 ms\), allowed are 2\.0"
            with pytest.raises(HardwareError, match=calls), link:
                pass
        assert wire.asked == 50


@pytest.mark.parametrize(("watchdog", "good"), [(0.010, True), (0.00999, False)])
def test_watchdog_needs_at_least_two_ticks(now, watchdog, good):
    wire = ScriptedWire()
    wire.watchdog = watchdog
    if good:
        with arm(wire):
            pass
    else:
        with pytest.raises(HardwareError, match="shorter than two ticks"), arm(wire):
            pass
    assert wire.calls == ["open", "stop", "close"]


def test_move_to_waits_for_the_string_to_settle(now):
    wire = TimedWire(now)
    arm(wire, settle=1.25).move_to((0.0, 0.1, 0.0))
    assert now.slept[-1] == 1.25
    assert now.slept.count(1.25) == 1


@pytest.mark.parametrize(
    ("way", "ticks"),
    [(0.0049, 0), (0.0051, 20), (0.2, int(np.ceil(0.2 * np.pi / 2 / 2.0 / 0.005)))],
)
def test_approach_duration_follows_its_speed(now, way, ticks):
    """At least twenty ticks; none for less than a quarter of the tolerance."""
    wire = TimedWire(now)
    arm(wire).move_to((0.0, 0.0, way))
    assert len(wire.sent) == (ticks + 1 if ticks else 0)
    assert np.abs(wire.sent or 0.0).max() <= 2.0 * 1.001
    assert wire.pose[2] == pytest.approx(way if ticks else 0.0)


def test_approach_is_repeated_three_times(now):
    wire = TimedWire(now)
    wire.send = lambda speeds: TimedWire.send(wire, 0.5 * np.asarray(speeds))
    arm(wire, astray=1.0).move_to((0.0, 0.0, 0.4))
    assert wire.calls.count("stop") == 3
    assert wire.pose[2] == pytest.approx(0.4 * (1 - 0.5**3))


@pytest.mark.parametrize(
    ("start", "off"), [(0.0, -0.02), (0.7, 0.0199), (0.7, -0.0201), (-0.7, 0.03)]
)
def test_movement_must_start_within_the_tolerance(now, start, off):
    wire = TimedWire(now)
    begins = movement().assign(q2=lambda table: table["q2"] + start)
    wire.pose = np.array([0.0, start + off, 0.0])
    if abs(off) <= 0.02:
        with arm(wire) as driven:
            assert len(driven.perform(begins).ticks) == len(begins)
    else:
        with pytest.raises(
            HardwareError,
            match=rf"{np.degrees(abs(off)):.1f} degrees from the movement's start",
        ):
            arm(wire).perform(begins)
        assert not wire.sent


def test_cleared_emergency_stop_sets_limits_again(now):
    wire = TimedWire(now)
    driven = arm(wire)
    driven._test_link()
    driven.press_emergency_stop("button")
    for act in (
        lambda: driven.move_to((0.0, 0.3, 0.0)),
        lambda: driven.perform(movement()),
    ):
        with pytest.raises(
            HardwareError, match=r"latched by the emergency stop \(button\)"
        ):
            act()
    driven.clear()
    assert wire.calls == ["clear"]
    assert wire.limits == ARM.speed
    driven.perform(movement())
    assert not driven.is_moving


def test_movement_time_starts_at_the_first_command(now):
    with arm(TimedWire(now), late=1e-3) as driven:
        made = driven.perform(movement().assign(t=lambda table: table["t"] - 0.25))
    assert made.arm["t"].iloc[0] == pytest.approx(-0.25, abs=1e-3)
    assert not made.ticks["missed"].any()


# --- limits

BOUNDS = {  # an allowed and a refused value of each setting
    "round_trip": ([1e-9], [0.0, -1.0]),
    "misses": ([1], [0]),
    "late": ([1e-9], [0.0]),
    "most_missed": ([0.0, 1.0], [-1e-9, 1.000001]),
    "astray": ([1e-9], [0.0]),
    "approach": ([1e-9], [0.0]),
    "settle": ([0.0], [-1e-9]),
    "priority": ([0, 99], [-1, 100]),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_driver_settings_out_of_bounds_are_refused(name):
    block = {**vars(DRIVING), "workspace": {"low": [-0.4, -0.4], "high": [0.8, 0.8]}}
    good, bad = BOUNDS[name]
    for value in good:
        assert (
            getattr(
                build_dataclass(Driving, {**block, name: value}, "driving", "here"),
                name,
            )
            == value
        )
    for value in bad:
        with pytest.raises(UserError, match=rf"driving\.{name}"):
            build_dataclass(Driving, {**block, name: value}, "driving", "here")


def swinging_angles(share, joint=1):
    """Make angles of a joint that accelerates to a share of its speed limit."""
    ticks = np.concatenate([np.linspace(0, 1, 20), np.linspace(1, 0, 20)])
    angles = np.zeros((41, 3))
    angles[1:, joint] = np.cumsum(share * ARM.speed[joint] * ticks) * ARM.tick
    return angles - angles[-1] / 2


ROOMY = {
    "hand_speed": 1e3,
    "acceleration": (1e6,) * 3,
    "lowest": (-3.0,) * 3,
    "highest": (3.0,) * 3,
}
ANYWHERE = Workspace((-9.0, -9.0), (9.0, 9.0))


def limit_left(limits, angles, workspace=ANYWHERE):
    """Return the reported limit and time [s]; empty if all limits are kept."""
    try:
        check_movement(ARM.__class__(**{**vars(ARM), **limits}), workspace, angles)
    except HardwareError as error:
        words = str(error).split()
        return words[words.index("leaves") + 1], float(words[words.index("s;") - 1])
    return ()


@pytest.mark.parametrize("joint", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_speed_limit_may_be_reached_but_not_exceeded(joint, sign):
    assert limit_left(ROOMY, sign * swinging_angles(1.0005, joint)) == ()
    # the joint is fastest in tick 19
    assert limit_left(ROOMY, sign * swinging_angles(1.0015, joint)) == (
        "arm.speed",
        0.095,
    )


def test_acceleration_limit_may_be_reached_but_not_exceeded():
    change = (
        np.abs(
            np.diff(ARM.commanded_velocities(swinging_angles(0.5)), axis=0, prepend=0.0)
        ).max()
        / ARM.tick
    )
    for share, calls in ((1.0005, ""), (1.0015, "arm.acceleration")):
        found = limit_left(
            {**ROOMY, "acceleration": (change / share,) * 3}, swinging_angles(0.5)
        )
        assert (found[0] if found else "") == calls
    late = np.concatenate(
        [np.repeat(swinging_angles(0.5)[:1], 30, axis=0), swinging_angles(0.5)]
    )
    assert (
        limit_left({**ROOMY, "acceleration": (change / 1.0015,) * 3}, late)[1] >= 0.150
    )


def test_hand_speed_limit_may_be_reached_but_not_exceeded():
    angles = swinging_angles(0.5, joint=0)
    # the arm is outstretched
    speed = ARM.commanded_velocities(angles)[:, 0].max() * ARM.reach
    for share, calls in ((1.0005, ""), (1.0015, "arm.hand_speed")):
        found = limit_left({**ROOMY, "hand_speed": speed / share}, angles)
        assert (found[0] if found else "") == calls


@pytest.mark.parametrize("end", ["lowest", "highest"])
@pytest.mark.parametrize("joint", range(3))
def test_joint_range_limits_may_be_touched(end, joint):
    angles = swinging_angles(0.5, joint)
    reached = angles[:, joint].min() if end == "lowest" else angles[:, joint].max()
    tight = list(ROOMY[end])
    tight[joint] = float(reached)
    assert limit_left({**ROOMY, end: tuple(tight)}, angles) == ()
    tight[joint] = float(np.nextafter(reached, 0.0))
    assert limit_left({**ROOMY, end: tuple(tight)}, angles)[0] == "arm.lowest"


@pytest.mark.parametrize(
    ("corner", "axis"), [("low", 0), ("low", 1), ("high", 0), ("high", 1)]
)
def test_workspace_edges_may_be_touched(corner, axis):
    angles = np.zeros((3, 3)) + [0.5, 0.2, 0.2] + np.array([[0.0], [1e-4], [2e-4]])
    places = ARM.joint_positions(angles)
    edge = {"low": [-9.0, -9.0], "high": [9.0, 9.0]}
    touched = places[..., axis].min() if corner == "low" else places[..., axis].max()
    edge[corner][axis] = float(touched)
    assert (
        limit_left(ROOMY, angles, Workspace(**{k: tuple(v) for k, v in edge.items()}))
        == ()
    )
    edge[corner][axis] = float(touched + (1e-9 if corner == "low" else -1e-9))
    found = limit_left(
        ROOMY, angles, Workspace(**{k: tuple(v) for k, v in edge.items()})
    )
    assert found[0] == "hardware.driving.workspace"


@pytest.mark.parametrize(
    ("low", "high"),
    [((0.0, 0.0), (0.0, 1.0)), ((0.0, 0.0), (1.0, 0.0)), ((2.0, 0.0), (1.0, 1.0))],
)
def test_workspace_without_area_is_refused(low, high):
    with pytest.raises(
        ValueError, match=r"each of workspace\.low must be below its workspace\.high"
    ):
        Workspace(low, high)


def test_test_movement_keeps_all_limits():
    check_movement(ARM, WORKSPACE, movement()[["q1", "q2", "q3"]].to_numpy())
