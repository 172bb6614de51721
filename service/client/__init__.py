"""A client of the service, which sends a capture, follows its job and fetches the results."""

from service.client.api import Client, DamagedDownload, Job, ServiceRefusal
from service.client.asynchronous import AsyncClient
from service.contract.errors import SetupError

__all__ = ["AsyncClient", "Client", "DamagedDownload", "Job", "ServiceRefusal", "SetupError"]
