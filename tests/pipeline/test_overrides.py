import hydra
import pytest

from pipeline.config import CONF_FOLDER
from pipeline.overrides import asks_hydra, literal, name_words, stray_word


@pytest.mark.parametrize(
    "value",
    [
        "one,two",
        "all,",
        "all,-one",
        "all, -*12?,-two",
        "-nusar-2021_one",
        "-*1001*",
        "/my rig (1)/*.mp4",
        "/d/[ab].mp4",
        "/{sequence_id}/b.parquet",
        "it's",
        "a'b\\'c",
        "x,\\",
        "ü",
        "",
    ],
)
def test_names_and_paths_mean_what_they_say(value: str) -> None:
    with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        assert hydra.compose("config", literal([f"seq={value}"])).seq == value


def test_what_hydra_can_read_is_left_to_it() -> None:
    readable = ["triangulate.max_reprojection_px=8.5", "rig.videos=/d/*.mp4", "seq='a,b'", "manifest=null", "~gc"]
    assert literal(readable) == readable


def test_a_comma_is_a_sweep_where_one_is_asked_for() -> None:
    assert literal(["seq=one,two", "--multirun", "run=a b,"]) == ["--multirun", "seq=one,two", "run='a b,'"]


def test_a_word_that_is_no_parameter_is_found() -> None:
    assert stray_word(["seq=one", "-m", "triangulate"]) == "triangulate"
    assert stray_word(["seq=one", "-m", "~gc"]) is None
    assert stray_word(["--cfg", "job"]) is None
    assert stray_word(["seq=one", "=3"]) == "=3"


@pytest.mark.parametrize("argument", ["-m", "--cfg", "hydra.verbose=true", "+hydra.job.name=a", "~hydra.run"])
def test_flags_and_settings_of_hydra_are_for_hydra(argument: str) -> None:
    ours = ["seq=all", "+triangulate.extra=1", "~gc"]
    assert asks_hydra([*ours, argument]) and not asks_hydra(ours)


def test_words_that_name_words_become_parameters() -> None:
    assert name_words(["a", "b", "workspace=/w"], "run", "other") == ["run=a", "other=b", "workspace=/w"]
    assert name_words(["run=a", "other=b"], "run", "other") == ["run=a", "other=b"]
    assert name_words(["a"], "run", "other") == ["run=a"] and name_words(["a"]) == ["a"]
    assert stray_word(name_words(["a", "b", "c"], "run", "other")) == "c"
