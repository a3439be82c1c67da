"""Verbs that talk to a glove, or are one."""

from pathlib import Path
from typing import Annotated

import typer

from palmar.cli_app import LOSS, HandName, Json, Object, OutFile, Seed, UserProfile, app, complain, parse_pairs

FullScale = Annotated[
    int, typer.Option(min=1, max=65535, help="Largest count: 4095 of an ESP32, 1023 of an AVR; the glove does not say.")
]
Duration = Annotated[float | None, typer.Option(min=0.01, help="End by itself after so long.")]


@app.command()
def record(
    *,
    device: Annotated[str, typer.Option(help="opengloves (lucidgloves: alpha or legacy encoding).")],
    port: Annotated[
        list[str],
        typer.Option(
            help="Serial port, pattern of names, usb:SERIAL-NUMBER or socket://HOST:PORT. May be repeated: all are "
            "tried when the glove comes back after an unplug."
        ),
    ],
    out: OutFile,
    baud: Annotated[int, typer.Option(min=50, help="Of the serial port.")] = 115200,
    full_scale: FullScale = 4095,
    hand: HandName = None,
    profile: UserProfile = None,
    side: Annotated[str | None, typer.Option(help="right or left; checked against the hand.")] = None,
    pose: Annotated[
        str,
        typer.Option(
            help="Where the palm is: constant[:X,Y,Z[,W,QX,QY,QZ]], keyboard, a scene of kind keys (TOML), a trace, or "
            "a stream of poses: udp://HOST:PORT, a serial port, socket://HOST:PORT."
        ),
    ] = "constant",
    pose_offset_ms: Annotated[float, typer.Option(help="How late the stream of poses is.")] = 0.0,
    pose_mount: Annotated[
        str, typer.Option(help="X,Y,Z[,W,QX,QY,QZ]: the palm in the frame of the tracker that the poses are of.")
    ] = "",
    duration_s: Duration = None,
    rate_hz: Annotated[
        float | None, typer.Option(min=0.1, help="What the glove's clock should give; its drift is then stated.")
    ] = None,
    passive: Annotated[bool, typer.Option(help="Send nothing, not even the answer that firmware waits for.")] = False,
    solve: Annotated[Path | None, typer.Option(help="Pack on which the solver runs while recording.")] = None,
    name: Object = "",
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="key=value for the solver; may be repeated.")
    ] = None,
    feedback: Annotated[bool, typer.Option(help="Send the solver's force back to each finger.")] = False,
    actuator: Annotated[
        list[str] | None,
        typer.Option(help="cap_n=20, brake_only=true, rate_n_per_s=0, quantum_n=0 of a finger; may be repeated."),
    ] = None,
    json: Json = False,
) -> int:
    """Glove -> trace, until Ctrl-C; raw bytes, readings and samples, whatever the port does meanwhile."""
    from palmar.files import require_file, require_place
    from palmar.recording import record as record_glove
    from palmar.terminal import print_fields, print_json

    require_place(out)
    answer = record_glove(
        device,
        port,
        out,
        baud=baud,
        full_scale=full_scale,
        hand_name=hand,
        profile_path=profile,
        side=side,
        pose=pose,
        pose_offset_ms=pose_offset_ms,
        pose_mount=pose_mount,
        duration_s=duration_s,
        rate_hz=rate_hz,
        passive=passive,
        solve=solve and require_file(solve),
        object_name=name,
        settings=parse_pairs("--set", setting or []),
        feedback=feedback,
        actuator=parse_pairs("--actuator", actuator or []),
    )
    failed = answer.get("failed", "")
    print_json(answer) if json else print_fields(answer)
    return complain(f"{failed}; what came before that is in the file", LOSS) if failed else 0


@app.command()
def emulate(
    trace: Annotated[Path, typer.Argument(help="Trace that the glove plays.")],
    *,
    hand: HandName = None,
    link: Annotated[Path | None, typer.Option(help="Symbolic link to the port; LINK-1, ... after unplugs.")] = None,
    listen: Annotated[str, typer.Option(help="HOST:PORT: be a socket instead of a serial port.")] = "",
    form: Annotated[
        str,
        typer.Option(help="curls: one number a finger, as current firmware; joints: all, and splay; legacy."),
    ] = "curls",
    full_scale: FullScale = 4095,
    rate_hz: Annotated[
        float | None,
        typer.Option(min=0.1, max=10000, help="Lines a second; else the trace's own, at most 200."),
    ] = None,
    lock_step: Annotated[bool, typer.Option(help="Wait for an answer after each line, up to 1 s.")] = False,
    auto_range: Annotated[bool, typer.Option(help="Scale to the range seen so far, as firmware does.")] = False,
    jitter_ms: Annotated[float, typer.Option(min=0, help="How late lines are, one standard deviation.")] = 0.0,
    drift_ppm: Annotated[float, typer.Option(help="How much too fast the glove's clock is; below 0, too slow.")] = 0.0,
    count_lines: Annotated[bool, typer.Option(help="The joystick gives the number of the line.")] = False,
    loop: Annotated[bool, typer.Option(help="Begin again where the trace ends.")] = False,
    duration_s: Duration = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="NAME=SHARE[:AMOUNT], such as garbage=0.01; all=1 for every one. May be repeated."),
    ] = None,
    seed: Seed = 0,
    log: Annotated[Path | None, typer.Option(help="Write what was sent, a JSON object a line.")] = None,
    poses_to: Annotated[str, typer.Option(help="udp://HOST:PORT: send the trace's palm poses there.")] = "",
    json: Json = False,
) -> None:
    """Trace -> a glove: a pseudo-terminal (its name is printed) that sends the lines a glove would."""
    from palmar.files import require_file
    from palmar.recording import emulate as emulate_glove
    from palmar.terminal import print_fields, print_json

    answer = emulate_glove(
        require_file(trace),
        hand_name=hand,
        link=link,
        listen=listen,
        form=form,
        full_scale=full_scale,
        rate_hz=rate_hz,
        lock_step=lock_step,
        auto_range=auto_range,
        jitter_ms=jitter_ms,
        drift_ppm=drift_ppm,
        count_lines=count_lines,
        loop=loop,
        duration_s=duration_s,
        faults={name: value for name, value in parse_pairs("--fault", fault or []).items()},
        seed=seed,
        log=log,
        poses_to=poses_to,
        say=lambda port: typer.echo(port, err=json),
    )
    print_json(answer) if json else print_fields(answer)
