"""Where tasks run: the parameters ``executor.…``, one class for each file in ``conf/executor``."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class LocalConfig(_Model):
    """This machine. ``num_workers`` 0 means one for each core; cores are shared out among the workers."""

    name: Literal["serial", "local"]
    num_workers: int = Field(ge=0)
    memory_limit: str


class TlsConfig(_Model):
    """Files of a TLS connection, in PEM: who is trusted, and this machine's own certificate and key."""

    ca: Path | None
    cert: Path | None
    key: Path | None


class _RemoteConfig(_Model):
    """What all workers on other machines have in common.

    Attributes:
        num_threads: threads that a task may use on its worker.
        wait_s: how long no worker at all may be there.
        needs_gpu: a worker that offers ``GPU=1`` has to be there before anything runs.
    """

    num_threads: int = Field(ge=1)
    wait_s: float = Field(gt=0)
    needs_gpu: bool

    @property
    def num_workers_at_most(self) -> int:
        """Return how many workers are used, 0 for all that there are."""
        return 0


class ClusterConfig(_RemoteConfig):
    """A scheduler that runs already; ``num_workers`` 0 means all workers that it has."""

    name: Literal["cluster"]
    scheduler: str | None
    num_workers: int = Field(ge=0)
    tls: TlsConfig

    @property
    def num_workers_at_most(self) -> int:
        """Return how many workers are used, 0 for all that there are."""
        return self.num_workers

    @model_validator(mode="after")
    def _check(self) -> "ClusterConfig":
        if self.scheduler is None:
            raise ValueError("executor=cluster needs executor.scheduler=tls://HOST:PORT (or tcp://)")
        if not self.scheduler.startswith(("tcp://", "tls://")):
            raise ValueError(f"executor.scheduler={self.scheduler} has to begin with tls:// or tcp://")
        files = (self.tls.ca, self.tls.cert, self.tls.key)
        if self.scheduler.startswith("tls://") and None in files:
            raise ValueError("tls:// needs executor.tls.ca, executor.tls.cert and executor.tls.key")
        return self


class SlurmConfig(_RemoteConfig):
    """Jobs of Slurm, each one worker; see ``conf/executor/slurm.yaml``."""

    name: Literal["slurm"]
    num_workers: int = Field(ge=1)
    queue: str | None
    account: str | None
    cores: int = Field(ge=1)
    memory: str
    gpus: int = Field(ge=0)
    walltime: str
    lifetime: str
    lifetime_stagger: str
    interface: str | None
    job_extra_directives: tuple[str, ...]
    job_script_prologue: tuple[str, ...]


class SshConfig(_RemoteConfig):
    """Machines that can be reached by ssh, the scheduler on the first; see ``conf/executor/ssh.yaml``."""

    name: Literal["ssh"]
    hosts: tuple[str, ...]
    num_workers: int = Field(ge=1)
    memory_limit: str
    remote_python: str | None
    port: int = Field(ge=1, le=65535)
    user: str | None
    known_hosts: Path | None

    @model_validator(mode="after")
    def _check(self) -> "SshConfig":
        if not self.hosts:
            raise ValueError("executor=ssh needs executor.hosts=[HOST,...]")
        return self


ExecutorConfig = Annotated[LocalConfig | ClusterConfig | SlurmConfig | SshConfig, Field(discriminator="name")]
RemoteConfig = ClusterConfig | SlurmConfig | SshConfig
