"""A complete client: streams RGB-D frames to Ghostlight and saves the last composite.

    pip install websockets numpy
    python minimal.py [ws://127.0.0.1:8080/ws [token]]

Written from ../README.md alone. The frames show a grey wall 1 m away; replace them with your camera.
"""

import asyncio
import json
import struct
import sys
import time

import numpy as np
import websockets

URL = sys.argv[1] if len(sys.argv) > 1 else "ws://127.0.0.1:8080/ws"
TOKEN = sys.argv[2] if len(sys.argv) > 2 else None
WIDTH, HEIGHT, FOCAL = 320, 240, 262.5
CAMERA = struct.pack("<2I4d", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5)
STILL = struct.pack("<7d", 0, 0, 0, 0, 0, 0, 1)  # translation, quaternion x y z w


def frame_message(sequence, rgb, depth_mm):
    color, depth = rgb.astype("u1").tobytes(), depth_mm.astype("<u2").tobytes()
    return b"".join([
        struct.pack("<2sBBIQq", b"GL", 1, 1, 240, sequence, time.time_ns()), STILL,  # 0, pose at 24
        CAMERA, CAMERA, STILL,                                  # 80 colour, 120 depth, 160 extrinsics
        struct.pack("<dBBHIIf", 0.001, 3, 16, 0, len(color), len(depth), 0.0),  # 216: rgb8, u16
        color, depth])


def composite(message):
    header_bytes, sequence, captured = struct.unpack_from("<4xIQq", message)
    received, sent = struct.unpack_from("<q48xq", message, 120)
    (image_bytes,) = struct.unpack_from("<I", message, 204)
    image = message[header_bytes:header_bytes + image_bytes]
    return sequence, time.time_ns() - captured, sent - received, image


async def main(n_frames=10):
    async with websockets.connect(URL, subprotocols=["ghostlight.v1"], max_size=None) as socket:
        hello = {"type": "hello", "version": 1, "role": "producer", "token": TOKEN}
        await socket.send(json.dumps(hello))
        rgb = np.full((HEIGHT, WIDTH, 3), 128)
        depth_mm = np.full((HEIGHT, WIDTH), 1000)
        for sequence in range(n_frames):
            await socket.send(frame_message(sequence, rgb, depth_mm))
            while isinstance(message := await socket.recv(), str):  # control messages
                if (control := json.loads(message))["type"] == "error":
                    sys.exit("{what}: expected {expected}, got {got}".format(**control))
            sequence, latency, in_server, image = composite(message)
            await socket.send('{"type":"credit"}')
            print(f"frame {sequence}: {latency / 1e6:.1f} ms, {in_server / 1e6:.1f} ms in the server")
        with open("composite.jpg", "wb") as file:
            file.write(image)

asyncio.run(main())
