"""The health check of the images: exit code 0 while the monitor ticks, by its page /healthz.

ROBOT_HEALTH_CHECK_URL is the address of the page; the certificate of an https address is not verified, since this
container is the server.
"""

import os
import ssl
import sys
import urllib.request

url = os.environ.get("ROBOT_HEALTH_CHECK_URL", "http://127.0.0.1:9090/healthz")
try:
    urllib.request.urlopen(url, timeout=4, context=ssl._create_unverified_context()).close()
except OSError as error:
    sys.exit(f"{url}: {error}")
