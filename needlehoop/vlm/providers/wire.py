"""An HTTP client that trusts no server: bounded answers, one address, no compression."""

from __future__ import annotations

import json
import time
from importlib import import_module
from typing import Any

from needlehoop.runs.reading import UnreadableError, parse_json

LARGEST = 1_000_000
"""Bytes of an answer, at most; what arrives beyond is not waited for. A reply has some 5,000."""


_TOLD = 1_000
"""Characters of an error that are passed on."""


class ReplyError(UnreadableError):
    """A reply that is none; says why, in words of ours."""


def careful(client: type[Any], seconds: float) -> Any:
    """A client for an SDK to speak through.

    It follows no redirect: a request's headers carry the key. It reads an answer as it comes,
    and stops where it is too large or its time is over. It asks for no compression and takes
    none: a few bytes can hold gigabytes.

    Args:
        client: httpx's ``Client``, or a class of its kind, of whatever package the SDK takes.
        seconds: that connecting, and each piece of an answer, may take, and the whole of it.
    """
    names = {base.__module__.partition(".")[0] for base in client.__mro__ if base is not object}
    http = import_module(min(names & {"httpx", "httpx2"}))

    class Careful(client):
        """See ``careful``."""

        def send(self, request: Any, **options: Any) -> Any:
            until = time.monotonic() + seconds
            request.headers["Accept-Encoding"] = "identity"
            try:
                response = super().send(
                    request, **{**options, "stream": True, "follow_redirects": False}
                )
                body = _body(response, until)
            except http.ProtocolError as error:
                raise ReplyError("the reply is no HTTP, or broke off") from error
            if response.status_code != 200:
                body = _refusal(response, body)
            elif not _is_text(body):
                raise ReplyError("the reply is no UTF-8")
            # Of the headers none is needed, and each is the server's to choose.
            return http.Response(
                response.status_code,
                headers={"Content-Type": "application/json"},
                content=body,
                request=request,
            )

    return Careful(timeout=seconds, follow_redirects=False)


def _refusal(response: Any, body: bytes) -> bytes:
    """What an error says, in a form that every SDK reads."""
    said = body.decode("utf-8", "replace")
    try:
        match parse_json(said):
            case {"error": {"message": str(message)}} | {"message": str(message)}:
                said = message
    except UnreadableError:
        # No JSON: then it is said as it is.
        pass
    if response.is_redirect:
        said = (
            f"it redirects to {response.headers.get('Location')!r}; the key goes nowhere unasked:"
            " give vlm.base_url if that is the server"
        )
    error = {"message": said[:_TOLD], "code": response.status_code}
    return json.dumps({"error": error}).encode()


def _is_text(body: bytes) -> bool:
    try:
        body.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


def _body(response: Any, until: float) -> bytes:
    """What a response holds, as it comes."""
    body = bytearray()
    try:
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise ReplyError("the reply is compressed, unasked")
        for piece in response.iter_raw():
            body += piece
            if len(body) > LARGEST:
                raise ReplyError(f"the reply is larger than {LARGEST:,} bytes")
            if time.monotonic() > until:
                raise TimeoutError
    finally:
        response.close()
    return bytes(body)
