"""Webhooks: the secret that signs an owner's messages, and the check of addresses to call."""

from __future__ import annotations

import base64
import ipaddress
import secrets
from urllib.parse import urlsplit

from service.contract.store import Store

# IPv6 addresses that a gateway translates to IPv4 addresses, even to private ones.
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
    """Return whether an IP address is public: it belongs neither to this machine nor to a private network."""
    found = ipaddress.ip_address(address.partition("%")[0])
    if isinstance(found, ipaddress.IPv6Address):
        if found in _TRANSLATED:
            return False
        found = found.ipv4_mapped or found.sixtofour or found
    return found.is_global and not found.is_multicast


def names_private_host(url: str) -> bool:
    """Return whether the text of a URL already names a private host.

    Other host names are checked at each call, when they are resolved.
    """
    host = urlsplit(url).hostname or ""
    try:
        return not is_public(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
