"""`mgsr-service`: only the API, for set-ups with a separate Redis server and workers. `keys` manages its keys.

Unlike `mgsr keys`, it does not load the library.
"""

from __future__ import annotations

import ipaddress
import logging
from typing import Annotated

import typer

from service.commands import keys
from service.contract.errors import SetupError, refusals

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
app.add_typer(keys, name="keys")

HostOption = Annotated[str, typer.Option(help="The address to listen on.")]
PortOption = Annotated[int, typer.Option(help="The port to listen on.", min=0, max=65535)]


@app.callback(invoke_without_command=True)
def main(context: typer.Context, host: HostOption = "127.0.0.1", port: PortOption = 8000) -> None:
    """Serve the API, with the queue at MGSR_REDIS_URL and the store at MGSR_STORE. With `keys`, manage its keys."""
    if context.invoked_subcommand is not None:
        return
    with refusals():
        serve_api(host, port)


def serve_api(host: str, port: int) -> None:
    """Answer requests until SIGTERM or SIGINT. Raises SetupError if the settings are unusable."""
    import uvicorn

    from service.app import create_app
    from service.contract.settings import Settings
    from service.contract.telemetry import open_telemetry
    from service.protocol import PatientProtocol

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s")
    app = create_app(Settings(), open_telemetry("mgsr-service"))
    if not app.state.parts.keys.needed() and not is_loopback(host):
        raise SetupError(
            f"--host {host}: a service without keys listens only on 127.0.0.1; create a key with `mgsr keys create "
            "NAME` first"
        )
    uvicorn.run(
        app,
        host=host,
        port=port,
        http=PatientProtocol,
        log_level="warning",
        access_log=False,
        timeout_graceful_shutdown=3,
        timeout_keep_alive=30,
        server_header=False,
    )


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


if __name__ == "__main__":
    app()
