from pathlib import Path

import hydra
import pytest
from omegaconf import DictConfig

from pipeline.config import CONF_FOLDER, UserError, check_config, unknown_key_message
from pipeline.executor_config import ClusterConfig, SlurmConfig, SshConfig
from pipeline.executors import resolve_workers
from pipeline.slurm_cluster import job_options


def _compose(*overrides: str) -> DictConfig:
    with hydra.initialize_config_dir(str(CONF_FOLDER), version_base="1.3"):
        return hydra.compose("config", list(overrides))


def test_the_defaults_are_valid_and_frozen() -> None:
    config = check_config(_compose())
    assert config.seq.startswith("nusar-2021_action_both_1002") and config.executor.name == "local"
    with pytest.raises(ValueError, match="frozen"):
        config.seq = "other"  # type: ignore[misc]
    with pytest.raises(ValueError, match="frozen"):
        config.stages["ingest"].chunk_frames = 1  # type: ignore[attr-defined]


@pytest.mark.parametrize(("said", "path"), [("", None), ("null", None), ("a.json", Path("a.json"))])
def test_a_corrected_file_without_a_name_is_none(said: str, path: Path | None) -> None:
    assert check_config(_compose(f"corrected={said}")).corrected == path


def test_overrides_reach_run_and_stages() -> None:
    config = check_config(_compose("ingest.chunk_frames=25", "executor=serial", "seq=all"))
    assert config.stages["ingest"].model_dump()["chunk_frames"] == 25
    assert (config.executor.name, config.seq) == ("serial", "all")
    assert "round_2" not in check_config(_compose("rounds=1")).dag.nodes


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("ingest.chunk_frames=0", r"ingest\.chunk_frames=0 is not possible: .*greater than or equal to 1"),
        ("ingest.chunk_frames=many", r"ingest\.chunk_frames='many' is not possible: .*integer"),
        ("executor.num_workers=-1", r"executor\.num_workers=-1 is not possible"),
        ("rounds=-1", r"rounds=-1 is not possible: .*greater than or equal to 0"),
        ("target=fly", "target=fly is unknown; choose among annotate"),
        ("+triangulate.extra=1", r"triangulate\.extra=1 is not possible: Extra inputs"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(override: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        check_config(_compose(override))


@pytest.mark.parametrize(
    ("target", "near"),
    [("anotate", " (did you mean annotate?)"), ("detect_hand", " (did you mean detect_hands?)"), ("0815", "")],
)
def test_an_unknown_target_gets_the_nearest_name_and_targets_alone(target: str, near: str) -> None:
    with pytest.raises(UserError) as refused:
        check_config(_compose(f"target='{target}'"))
    said = str(refused.value)
    assert said.startswith(f"target={target} is unknown{near}; choose among annotate, smooth, evaluate, doctor,")
    assert said.endswith(", train_own, or a node of `python -m pipeline describe`") and "undistort_ego" not in said


@pytest.mark.parametrize("parameter", ["run", "other"])
@pytest.mark.parametrize("name", ["../store", "/abs/mine", "runs/foo", ".", "..", ".hidden", "a\\\\b", "x" * 121])
def test_a_run_has_no_name_that_leads_elsewhere(parameter: str, name: str) -> None:
    with pytest.raises(UserError, match=rf"^{parameter}=\S+ cannot name a run: runs are folders of work/runs; give"):
        check_config(_compose(f"{parameter}='{name}'"))


@pytest.mark.parametrize("name", ["", "latest", "monday_2.1", "sweep-20260101-120000-00", "montag früh", "x" * 120])
def test_a_run_may_have_any_plain_name(name: str) -> None:
    assert check_config(_compose(f"run='{name}'", f"other='{name}'")).run == name


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("executor=cluster", r"^executor=cluster needs executor\.scheduler=tls://HOST:PORT \(or tcp://\)$"),
        ("executor=cluster executor.scheduler=udp://a:1", r"^executor\.scheduler=udp://a:1 has to begin with tls://"),
        ("executor=cluster executor.scheduler=tls://a:1", r"^tls:// needs executor\.tls\.ca, executor\.tls\.cert and"),
        ("executor=ssh", r"^executor=ssh needs executor\.hosts=\[HOST,\.\.\.\]$"),
        ("executor=slurm executor.cores=0", r"^executor\.cores=0 is not possible: .*greater than or equal to 1"),
        ("executor=cluster executor.wait_s=0", r"^executor\.wait_s=0 is not possible: .*greater than 0"),
    ],
)
def test_executors_say_what_they_need(overrides: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        check_config(_compose(*overrides.split()))


def test_executors_that_are_told_enough_are_valid() -> None:
    tls = [f"executor.tls.{name}=/a/{name}.pem" for name in ("ca", "cert", "key")]
    cluster = check_config(_compose("executor=cluster", "executor.scheduler='tls://a:1'", *tls)).executor
    assert isinstance(cluster, ClusterConfig) and cluster.tls.key == Path("/a/key.pem")
    assert resolve_workers(cluster) == (1, 1) and cluster.num_workers_at_most == 0
    ssh = check_config(_compose("executor=ssh", "executor.hosts=[a,b]", "executor.num_workers=3")).executor
    assert isinstance(ssh, SshConfig) and ssh.hosts == ("a", "b") and ssh.num_workers_at_most == 0
    assert resolve_workers(ssh) == (6, 1), "three on each of two hosts"
    slurm = check_config(_compose("executor=slurm", "executor.gpus=2", "executor.queue=fast")).executor
    assert isinstance(slurm, SlurmConfig)
    job = job_options(slurm)
    assert job["job_extra_directives"] == ["--gres=gpu:2"] and job["worker_extra_args"][-2:] == ["--resources", "GPU=1"]
    assert (job["queue"], job["cores"], job["walltime"], job["processes"]) == ("fast", 4, "01:00:00", 1)


@pytest.mark.parametrize(
    ("override", "near"),
    [
        ("ingest.chunk_frame=1", "did you mean ingest.chunk_frames?"),
        ("zzz=x", "`--cfg job` prints all parameters"),
        ("triangulte.max_reprojection_px=3", "did you mean triangulate.max_reprojection_px?"),
        ("max_reprojection_px=3", "did you mean triangulate.max_reprojection_px?"),
        ("executer=serial", "did you mean executor?"),
    ],
)
def test_an_unknown_key_gets_the_nearest_name(override: str, near: str) -> None:
    message = unknown_key_message([override], _compose())
    assert message is not None and message.startswith(f"there is no parameter {override.split('=')[0]}")
    assert near in message


def test_known_keys_groups_and_additions_pass() -> None:
    overrides = [
        "seq=a",
        "executor=serial",
        "executor.num_workers=2",
        "rig.videos='*.mp4'",
        "+new.key=1",
        "hydra.verbose=true",
    ]
    assert unknown_key_message(overrides, _compose()) is None
