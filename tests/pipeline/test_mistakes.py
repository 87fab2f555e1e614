"""Mistakes on the command line are answered with one line and the correct command."""

import re
import shlex

import pytest

from stringcast.pipeline.cli.command_line_hints import join_quoted, refuse_mistakes
from stringcast.pipeline.commands import COMMAND_NAMES
from stringcast.pipeline.settings.composition import UserError, compose_settings
from tests.pipeline.test_readme_commands import CALLS, PLACEHOLDER, fill_plugin

MEANT = {
    "stringB": "+experiment=stringB",
    "experiment=stringB seed=3": "+experiment=stringB seed=3",
    "--experiment stringB seed=3": "+experiment=stringB seed=3",
    "--experiment=stringB": "+experiment=stringB",
    "+experiment=stringb": "+experiment=stringB",
    "+experiment=diganose trials=data/sample": "+experiment=diagnose trials=data/sample",
    "chek data/sample": "check data/sample",
    "Verify outputs": "verify outputs",
    "diagnose trials=data/sample": "+experiment=diagnose trials=data/sample",
    "diagnose data/sample": "+experiment=diagnose trials=data/sample",
    "+experiment=diagnose data/sample": "+experiment=diagnose trials=data/sample",
    "+experiment=diagnose": "+experiment=diagnose trials=data/sample",
    "run seed=3": "+experiment=stringB method=adaptive seed=3",
    "help": "--help",
    "target=at_400_70": "target=at_400_700",
    "target=400,700": "target.x=0.4 target.y=0.7",
    "target=(0.4,0.7)": "target.x=0.4 target.y=0.7",
    "estimate=leastsquares": "estimate=least_squares",
    "estimat=least_squares": "estimate=least_squares",
    "method=robst": "method=robust",
    "trial=data/sample": "trials=data/sample",
    "sed=3": "seed=3",
    "target.x=400 target.y=700": "target.x=0.4 target.y=0.7",
    "string.length=300": "string.length=0.3",
    "string.length=30cm": "string.length=0.3",
    "seed = 3": "seed=3",
    "seed: 3": "seed=3",
    "source.video=film.mp4 +experiment=calibrate": "source=video source.path=film.mp4 +experiment=calibrate",
    "source=video source.video=film.mp4": "source=video source.path=film.mp4",
    "source.images=tilted": "source=images source.folder=tilted",
    "--seed 3": "seed=3",
    "--seed=3 stringB": "seed=3 +experiment=stringB",
    "effects=wind": "'effects=[wind]'",
    "effects=wind,tip_mass": "'effects=[wind,tip_mass]'",
    "parameter_values.tip_mass.ratio=0.05": "+parameter_values.tip_mass.ratio=0.05",
}


@pytest.mark.parametrize(("typed", "meant"), MEANT.items(), ids=MEANT)
def test_mistakes_are_answered_with_the_intended_command(typed, meant):
    with pytest.raises(
        UserError, match=f"Try: \\S*python\\S* -m pipeline {re.escape(meant)}$"
    ) as refused:
        refuse_mistakes(typed.split())
    assert "\n" not in str(refused.value)


def test_colon_is_not_repeated():
    with pytest.raises(UserError, match=r"^seed: write name and value together\."):
        refuse_mistakes(["seed:", "3"])


def test_unrecognised_words_list_the_alternatives():
    with pytest.raises(UserError, match=r"neither a command .*check.* nor a setting"):
        refuse_mistakes(["xyzzy"])
    with pytest.raises(
        UserError,
        match=r"\+nosuch=x: there is no setting 'nosuch'. All settings: .* --help",
    ):
        refuse_mistakes(["+nosuch=x"])  # Hydra would accept it
    with pytest.raises(UserError, match="-x: there is no such option"):
        refuse_mistakes(["-x"])
    with pytest.raises(UserError, match=r"python3 tasks.py test"):
        refuse_mistakes(["test"])
    with pytest.raises(
        UserError,
        match="specimen=7: there is no such option; there are A, B, C, D, long",
    ):
        refuse_mistakes(["specimen=7"])
    with pytest.raises(
        UserError,
        match=r"arm=ours: .*; there is paper; .*python.* -m pipeline new arm ours writes your own",
    ):
        refuse_mistakes(["arm=ours"])
    for word in ("specimen=null", "specimen="):  # Hydra would end in a traceback
        with pytest.raises(UserError, match=f"{word}: there is no such option"):
            refuse_mistakes([word])


@pytest.mark.parametrize("call", sorted({call for _, call in CALLS}))
def test_commands_on_pages_are_accepted(call, plugin):
    fill_plugin(plugin, call)
    if call.partition(" ")[0] not in COMMAND_NAMES:
        refuse_mistakes(shlex.split(PLACEHOLDER.sub("place", call)))


@pytest.mark.parametrize(
    "word",
    [
        "target.x=0.4",
        "~obstacles",
        "seed=1,2",
        "estimate=random_search,cma_es",
        "obstacles=none",
        "-v",
        "name=stringB",
        "plane.folder=flat",
        "source@plane=video",
        "hydra/launcher=joblib",
        "+specimen.hidden.wind.along_x=1",
        # longer than a file name may be
        f"diagnose.excluded_effects=[{','.join(30 * ['grasp_play'])}]",
    ],
)
def test_correct_words_are_accepted(word):
    refuse_mistakes([word])


@pytest.mark.parametrize(
    "words",
    [
        "--cfg job",
        "-c all --resolve",
        "+experiment=stringB --cfg job -p string",
        "--info searchpath",
        "--info",
        "--shell-completion install=bash",
        "-cd settings target=mine",
    ],
)
def test_options_of_hydra_are_accepted(words):
    refuse_mistakes(words.split())


def test_mistakes_after_an_option_of_hydra_are_found():
    with pytest.raises(UserError, match=r"Try: .* --cfg job seed=3$"):
        refuse_mistakes(["--cfg", "job", "sed=3"])
    with pytest.raises(UserError, match=r"Try: .* --info seed=3$"):
        refuse_mistakes(["--info", "sed=3"])


def test_unknown_hardware_is_answered_with_the_command_new():
    with pytest.raises(UserError, match="new arm ur5 writes the settings") as refused:
        refuse_mistakes(["hardware=ur5"])
    assert "there are dynamixel, emulator, serial, virtual" in str(refused.value)


def test_quotes_kept_by_windows_shells_are_removed():
    typed = "check 'my folder' 'effects=[tip_mass]' '+a={value: 1,' 'low: 2}'"
    assert join_quoted(typed.split(" ")) == [
        "check",
        "my folder",
        "effects=[tip_mass]",
        "+a={value: 1,",
        "low: 2}",
    ]
    untouched = ["trials=my folder", "name=it's", "name='quoted'", "'open"]
    assert join_quoted(untouched) == untouched


def test_paths_with_blanks_work_and_those_with_commas_need_quotes(tmp_path):
    plain, odd = tmp_path / "my trials", tmp_path / "my, trials (1)"
    plain.mkdir()
    odd.mkdir()
    call = "+experiment=diagnose"
    refuse_mistakes([call, f"trials={plain}"])
    with pytest.raises(UserError, match="quotes of its own") as refused:
        refuse_mistakes([call, f"trials={odd}"])
    *_, quoted = shlex.split(str(refused.value))
    refuse_mistakes([call, quoted])
    assert compose_settings([call, quoted])["trials"] == str(odd)
    assert compose_settings([call, f"trials={plain}"])["trials"] == str(plain)


def test_words_beyond_ascii_are_answered_with_quotes(called):
    result = called("+experiment=quick", "name=Jörg")
    assert result.returncode == 1
    assert re.search(
        r"""^Error: name=Jörg: .*Try: \S+ -m \w+ \+experiment=quick 'name="Jörg"'$""",
        result.stderr.strip(),
    )


def test_several_values_are_answered_with_a_sweep(called):
    result = called("method=paper,robust", "seed=1")
    assert result.returncode == 1
    assert re.search(
        r"method=paper,robust: .*Try: \S+ -m \w+ --multirun method=paper,robust seed=1$",
        result.stderr.strip(),
    )
