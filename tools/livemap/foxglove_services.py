"""Services for Foxglove viewers: an emergency stop and its release, both with a key that was printed.

Pages of other sites may connect to the port of `--foxglove`, so neither is open to everybody there. A
stop that needs no key is the button of the map, `headland stop`, or a real one. A release also needs
the operator's key of the map or launch (`tools/livemap/stop_panel.py`).
"""

import asyncio
import json
from collections.abc import Awaitable, Callable, Sequence
from secrets import compare_digest
from typing import Any

from foxglove import Schema
from foxglove.websocket import MessageSchema, Service, ServiceRequest, ServiceSchema

from tools.livemap.stop_panel import Panel, PanelError, told_result

STOP, RELEASE = "/emergency_stop", "/release"
ANSWER_S = 30.0  # as long as the panel itself may take
NO_RELEASE = "there is no operator's key here: start the map or launch with --operator-key"
WRONG_KEY = (
    "the key is wrong: it is the one that the launch printed, or the token of the map's address"
)
Asked = Callable[[], Awaitable[dict[str, Any]]]


def services_of(panel: Panel, key: str) -> Sequence[Service]:
    """What a viewer may call. The handlers run in threads of the server, and wait for the bus.

    Call it in the loop of the panel. `key`: what a request has to say.
    """
    loop = asyncio.get_running_loop()

    async def release() -> dict[str, Any]:
        if not panel.releases:
            raise PanelError(NO_RELEASE)
        return await panel.release(keyless=False, reset=True, start=True)

    def handler(asked: Asked) -> Callable[[ServiceRequest], bytes]:
        def answer(request: ServiceRequest) -> bytes:
            if not _has_key(request.payload, key):
                return _told(False, WRONG_KEY)
            try:
                running = asyncio.run_coroutine_threadsafe(_asked(asked), loop)
                found = running.result(ANSWER_S)
            except (PanelError, TimeoutError) as problem:
                return _told(False, str(problem) or f"no answer in {ANSWER_S:.0f} s")
            return _told(*told_result(found))

        return answer

    return [_service(STOP, handler(panel.stop)), _service(RELEASE, handler(release))]


async def _asked(asked: Asked) -> dict[str, Any]:
    return await asked()


def _has_key(payload: bytes, key: str) -> bool:
    """Whether a request says the key; what is no JSON object does not."""
    try:
        said = json.loads(payload)
        word = said.get("key") if isinstance(said, dict) else None
        return isinstance(word, str) and compare_digest(word.encode(), key.encode())
    except (ValueError, RecursionError):
        return False


def _told(success: bool, message: str) -> bytes:
    return json.dumps({"success": success, "message": message}).encode()


def _service(name: str, handler: Callable[[ServiceRequest], bytes]) -> Service:
    request = _schema("Request", {"key": {"type": "string"}})
    response = _schema("Response", {"success": {"type": "boolean"}, "message": {"type": "string"}})
    schema = ServiceSchema(name.strip("/"), request=request, response=response)
    return Service(name, schema=schema, handler=handler)


def _schema(name: str, fields: dict[str, Any]) -> MessageSchema:
    told = {"type": "object", "properties": fields, "required": list(fields)}
    schema = Schema(name=name, encoding="jsonschema", data=json.dumps(told).encode())
    return MessageSchema(encoding="json", schema=schema)
