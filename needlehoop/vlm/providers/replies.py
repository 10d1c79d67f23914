"""What servers answer, read by a schema: nothing else of it gets any further."""

from __future__ import annotations

import json
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.alias_generators import to_camel

from needlehoop.runs.reading import UnreadableError, parse_json
from needlehoop.vlm.providers.wire import ReplyError

R = TypeVar("R", bound="ReplyPart")

Count = Annotated[int, Field(ge=0, le=2**53)]


class ReplyPart(BaseModel):
    """Of the exact types, under the names that the server uses; what else there is is dropped."""

    model_config = ConfigDict(strict=True, extra="ignore", alias_generator=to_camel)


def read_reply(body: bytes, form: type[R], key: str | None) -> R:
    """A reply's body.

    Args:
        body: as it came.
        form: what of it is wanted.
        key: struck out wherever it is repeated.

    Raises:
        ReplyError: it is not UTF-8, no JSON, too deep, or of another form.
    """
    try:
        found = parse_json(body.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ReplyError("the reply is no UTF-8") from error
    except UnreadableError as error:
        raise ReplyError(f"the reply {error}") from error
    try:
        # Halves of characters, which JSON can spell, could not be written down.
        json.dumps(found, ensure_ascii=False).encode()
        return form.model_validate(_struck(found, key))
    except UnicodeEncodeError as error:
        raise ReplyError("the reply has halves of characters") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "all of it"
        raise ReplyError(f"the reply is of another form: {where}: {first['msg']}") from error


def strike(text: str, key: str | None) -> str:
    """A text without the key, also where it is JSON that spells the key in another way."""
    if not key:
        return text
    plain = text.replace(key, "***")
    if "\\" not in plain:
        return plain
    try:
        found = parse_json(plain)
    except UnreadableError:
        return plain
    clean = _struck(found, key)
    return plain if clean == found else json.dumps(clean)


def _struck(value: Any, key: str | None) -> Any:
    """A JSON value without the key."""
    if isinstance(value, str):
        return strike(value, key)
    if isinstance(value, dict):
        return {strike(name, key): _struck(inner, key) for name, inner in value.items()}
    return [_struck(inner, key) for inner in value] if isinstance(value, list) else value
