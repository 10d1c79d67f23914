"""A server on this machine that speaks Gemini's and OpenAI's protocols."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

KEY = "sk-very-secret-0123456789"

Answer = str | dict[str, Any]


def by_schema(schema: dict[str, Any], prompt: str = "") -> str:
    """A valid answer to any question: the first of each choice, rankings in their order."""
    return json.dumps(_value(schema, schema.get("$defs", {})))


def _value(schema: dict[str, Any], defs: dict[str, Any]) -> Any:
    if "$ref" in schema:
        return _value(defs[schema["$ref"].rpartition("/")[2]], defs)
    if "enum" in schema:
        return schema["enum"][0]
    if schema["type"] == "object":
        return {name: _value(inner, defs) for name, inner in schema["properties"].items()}
    if schema["type"] == "array":
        (place,) = (entry for entry in defs.values() if "name" in entry["properties"])
        names = place["properties"]["name"]["enum"]
        if schema["items"].get("type") == "number":
            return [0.75] * (len(names) - 1)
        return [{"name": name, "reason": f"because of {name}"} for name in names]
    return "so be it"


@dataclass
class Server:
    """What the server says, in order, and what it was asked.

    An entry of ``script`` is a text (the model's answer), or a dict with ``status`` and ``body``
    (any reply), or ``finish``/``refusal`` with ``text``. Past its end, ``otherwise`` answers from
    the request's JSON schema.
    """

    script: list[Answer] = field(default_factory=list)
    otherwise: Callable[[dict[str, Any], str], str] = by_schema
    requests: list[dict[str, Any]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)
    url: str = ""

    def answer(self, path: str, body: dict[str, Any]) -> tuple[int, str]:
        self.requests.append(body)
        if "contents" in body:
            schema = body["generationConfig"]["responseJsonSchema"]
            parts = body["contents"][-1]["parts"]
        else:
            schema = body["response_format"]["json_schema"]["schema"]
            parts = body["messages"][-1]["content"]
        prompt = "".join(part.get("text", "") for part in parts)
        entry = self.script.pop(0) if self.script else self.otherwise(schema, prompt)
        answer = {"text": entry} if isinstance(entry, str) else entry
        if "body" in answer or "status" in answer:
            return answer.get("status", 200), answer.get("body", '{"error": {"message": "no"}}')
        reply = gemini_reply if "generateContent" in path else openai_reply
        return 200, json.dumps(reply(answer))


def gemini_reply(answer: dict[str, Any]) -> dict[str, Any]:
    usage = {"promptTokenCount": 100, "candidatesTokenCount": 10, "thoughtsTokenCount": 5}
    reply: dict[str, Any] = {"modelVersion": "gemini-test-001", "usageMetadata": usage}
    if "refusal" in answer:
        return {**reply, "promptFeedback": {"blockReason": answer["refusal"]}}
    content = {"role": "model", "parts": [{"text": answer["text"]}]}
    finish = answer.get("finish", "STOP")
    return {**reply, "candidates": [{"content": content, "finishReason": finish, "index": 0}]}


def openai_reply(answer: dict[str, Any]) -> dict[str, Any]:
    message = {"role": "assistant", "content": answer["text"], "refusal": answer.get("refusal")}
    finish = answer.get("finish", "stop")
    return {
        "id": "1",
        "object": "chat.completion",
        "created": 0,
        "model": "test-model-001",
        "choices": [{"index": 0, "message": message, "finish_reason": finish}],
        "usage": {"prompt_tokens": 100, "completion_tokens": 15, "total_tokens": 115},
    }


@contextmanager
def serve() -> Iterator[Server]:
    """A server on a free port, for as long as the context lasts."""
    server = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            server.headers.append(dict(self.headers))
            status, text = server.answer(self.path, body)
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(text.encode())))
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *_: object) -> None:
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.url = f"http://127.0.0.1:{http.server_port}"
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        http.shutdown()
        thread.join()
        http.server_close()
