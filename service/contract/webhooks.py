"""Webhooks: the secret that signs an owner's messages, and which addresses may be called."""

from __future__ import annotations

import base64
import ipaddress
import secrets
from urllib.parse import urlsplit

from service.contract.store import Store

# IPv6 addresses that a gateway turns into IPv4 ones, inside networks too.
_TRANSLATED = ipaddress.IPv6Network("64:ff9b::/96")


def webhook_secret(store: Store, owner: str) -> str:
    """Return the owner's secret (Standard Webhooks: `whsec_` and base64), which the first request creates."""
    path = f"webhook-secrets/{owner}"
    if (found := store.read(path)) is None:
        made = "whsec_" + base64.b64encode(secrets.token_bytes(32)).decode()
        store.create(path, made.encode())
        found = store.read(path)
        assert found is not None
    return found.decode()


def is_public(address: str) -> bool:
    """Return whether an IP address belongs to the open internet, not to this machine or a network around it."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        if found in _TRANSLATED:
            return False
        found = found.ipv4_mapped or found.sixtofour or found
    return found.is_global and not found.is_multicast


def names_private_host(url: str) -> bool:
    """Return whether the URL names a private host by its mere text.

    Host names are checked when they are resolved, at each call.
    """
    host = urlsplit(url).hostname or ""
    try:
        return not is_public(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
