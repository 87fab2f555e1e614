"""The firmware in C gives the answers of the Python firmware.

Golden frames and fuzzed bytes go to both, and the real driver drives the C device over
a pseudo-terminal.
"""

import random
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from rig import driver, movement

from stringcast.hardware.serial.firmware import Firmware
from stringcast.hardware.serial.protocol import (
    PROTOCOL_VERSION,
    Command,
    FrameKind,
    encode_command,
)
from stringcast.stages.execute.interfaces import HardwareError

FOLDER = Path(__file__).resolve().parents[2] / "hardware" / "serial" / "device"
POSE = (0.5, 0.25, -1.0)
STRICT = [
    "-std=c99",
    "-O1",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Werror",
]
# Memory accesses are checked where the compiler supports it.
WATCHED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Compile the device with one of its two mains; return the program's path."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("device")

    def build(main):
        program = folder / main
        sources = [str(FOLDER / f"{main}.c"), str(FOLDER / "stringcast.c"), "-lm"]
        if not program.exists():
            command = [compiler, *STRICT, "-o", program, *sources]
            watched = subprocess.run(
                [*command, *WATCHED], check=False, capture_output=True
            )
            if watched.returncode:
                subprocess.run(command, check=True)
        return program

    return build


def in_python(data):
    """Answer as pipe.c does: a byte at a time, with 1 ms after every delimiter."""
    firmware, out, now = Firmware(), b"", 0
    for byte in data:
        firmware.tick(now)
        out += firmware.receive(bytes([byte]), now, POSE)
        now += 1000 * (byte == 0)
    return out


def in_c(program, data):
    return subprocess.run(
        [program], input=data, capture_output=True, check=True, timeout=20
    ).stdout


def golden():
    lines = (FOLDER / "golden.txt").read_text().splitlines()
    return (
        b"".join(bytes.fromhex(x[2:]) for x in lines if x.startswith(side))
        for side in "><"
    )


def test_python_holds_the_golden_conversation():
    said, answered = golden()
    assert encode_command(Command(FrameKind.VELOCITY, 65535, (1.5, -2.25, 0.0))) in said
    assert in_python(said) == answered


def test_c_holds_the_golden_conversation(built):
    said, answered = golden()
    assert in_c(built("pipe"), said) == answered


def fuzz(rng):
    """Make whole commands of every kind among torn, flipped, overlong and random ones.

    The whole ones make sure that all states are reached.
    """
    sequence = 0
    stream = encode_command(Command(FrameKind.HELLO, 0, (PROTOCOL_VERSION,)))
    odd = [0.0, 1.5, -3.0, 0.1, -0.0, 1e30, -1e30, float("nan"), float("inf")]
    values = {
        FrameKind.VELOCITY: lambda: [
            rng.choice(odd[: rng.choice([1, 2, 5, 9])]) for _ in range(3)
        ]
    }
    usual = [2.0] * 3 + [300.0] * 3
    strange = [2.0, 1.5, 300.0, 0.0, 1e-3, -1.0, float("nan")]
    values[FrameKind.LIMITS] = lambda: [
        *rng.choice([usual, usual, [rng.choice(strange) for _ in range(6)]]),
        rng.choice([0, 5000]),
        rng.choice([0, 7, 400]),
    ]
    values[FrameKind.HELLO] = lambda: [
        rng.choice([PROTOCOL_VERSION, PROTOCOL_VERSION, 1])
    ]
    for _ in range(300):
        kind = rng.choice(
            [
                *[k for k in FrameKind if k < 0x80],
                FrameKind.VELOCITY,
                FrameKind.VELOCITY,
                FrameKind.HELLO,
                FrameKind.LIMITS,
            ]
        )
        sequence = (sequence + rng.choice([1, 1, 1, 0, -1, 40000])) % 2**16
        frame = bytearray(
            encode_command(Command(kind, sequence, tuple(values.get(kind, list)())))
        )
        harm = rng.randrange(8)
        if harm == 0:
            frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
        elif harm == 1:
            frame = frame[: rng.randrange(len(frame))]
        elif harm == 2:
            frame = (
                bytearray(rng.randbytes(rng.choice([1, 5, 63, 64, 65, 66, 300])))
                + b"\0"
            )
        elif harm == 3:
            frame += b"\0" * rng.choice([1, 5, 30])
        stream += bytes(frame)
    return stream


@pytest.mark.parametrize("seed", range(20))
def test_c_answers_fuzzed_bytes_as_python_does(built, seed):
    stream = fuzz(random.Random(seed))
    answered = in_python(stream)
    assert in_c(built("pipe"), stream) == answered
    assert len(answered) > 1000  # the device answered


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("get(payload + count, CHECK) != crc32(payload, count)", "0"),
        ("fmin(fmax(wanted, -speed), speed)", "wanted"),
        ("fmin(fmax(slow, was - change), was + change)", "slow"),
        ("unbound(device);", ""),
        ("now_us - device->heard_us > 1000u * patience", "0"),
        ("patience < device->watchdog_ms ? patience : device->watchdog_ms", "patience"),
    ],
)
def test_a_device_that_is_wrong_is_found_out(tmp_path, right, wrong):
    """Without checksum, a limit or the watchdog, fuzzed bytes give other answers."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    text = (FOLDER / "stringcast.c").read_text()
    assert text.count(right) == 1
    (tmp_path / "stringcast.c").write_text(text.replace(right, wrong))
    sources = [tmp_path / "stringcast.c", FOLDER / "pipe.c", f"-I{FOLDER}", "-lm"]
    subprocess.run(
        [compiler, "-std=c99", "-o", tmp_path / "pipe", *sources],
        check=True,
        capture_output=True,
    )
    streams = [fuzz(random.Random(seed)) for seed in range(20)]
    assert any(
        in_c(tmp_path / "pipe", stream) != in_python(stream) for stream in streams
    )


@pytest.fixture
def port(built):
    process = subprocess.Popen(
        [built("posix"), "250", "30"], stdout=subprocess.PIPE, text=True
    )
    yield process.stdout.readline().strip()
    process.kill()
    process.wait()
    process.stdout.close()


def test_the_real_driver_moves_the_device_in_c(port):
    with driver(port) as arm:
        performance = arm.perform(movement())
        np.testing.assert_allclose(arm.angles(), [0.5, -0.4, 0.6], atol=0.1)
    assert performance.ticks["t_acknowledged"].notna().mean() > 0.5


def held(wire, number, within=5.0):
    """Return why the device did not follow a command, as its answer says."""
    end = time.monotonic() + within
    while time.monotonic() < end:
        for answer in wire.answers():
            if answer.number == number:
                return answer.hold_reason
        time.sleep(0.01)
    return None


def test_the_device_in_c_stands_when_its_host_falls_silent_and_must_be_greeted_again(
    port,
):
    with driver(port) as arm:
        arm.wire.send(np.array([0.5, 0.0, 0.0]))
        time.sleep(0.6)
        there = arm.angles()
        assert there[0] > 0
        number, _ = arm.wire.send(np.array([0.5, 0.0, 0.0]))
        assert "watchdog" in held(arm.wire, number)
        np.testing.assert_array_equal(arm.angles(), there)
    with driver(port) as arm:
        arm.wire.latch()
    with pytest.raises(HardwareError, match="latched"), driver(port):
        pass
