"""/webhook-secret: the secret with which receivers of webhooks check signatures."""

from __future__ import annotations

from fastapi import APIRouter
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, Field

from service.contract.webhooks import webhook_secret
from service.parts import OwnerDep, PartsDep
from service.problems import answers

router = APIRouter(tags=["webhooks"])


class WebhookSecret(BaseModel):
    """The secret of an owner, which never changes."""

    secret: str = Field(description="`whsec_` and base64, as libraries for Standard Webhooks expect.")


@router.get("/webhook-secret", responses=answers())
async def get_webhook_secret(owner: OwnerDep, parts: PartsDep) -> WebhookSecret:
    """Get the secret that signs the messages of your jobs' webhooks."""
    return WebhookSecret(secret=await run_in_threadpool(webhook_secret, parts.jobs.store, owner))
