"""A page opened in a browser without a window, for as long as what is waited for takes: busy cores draw slowly."""

import http.server
import pathlib
import re
import shutil
import subprocess
import threading

BROWSER = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
SWITCHES = "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --enable-logging=stderr"
PATIENCE = 90.0  # s, then the page is taken as it is
WATCHED = """<script>
%s
const look = () => {
%s
};
const looking = setInterval(() => {
  const found = look();
  if (!found) return;
  Object.assign(document.body.dataset, found);
  if (%s) {
    clearInterval(looking);
    new Image().src = "http://127.0.0.1:%d/enough";
  }
}, 30);
</script><img alt="" src="http://127.0.0.1:%d/late"></body>"""


class Late(http.server.BaseHTTPRequestHandler):
    """The page is loaded when this has answered, which is once the page has said that it has enough."""

    def do_GET(self):
        if self.path == "/enough":
            self.server.enough.set()
        self.server.enough.wait(PATIENCE)
        self.send_response(404)
        self.end_headers()

    def log_message(self, *words):
        pass


def opened(text: str, path: pathlib.Path, look: str, enough: str, before: str = "") -> tuple[str, str, list[str]]:
    """The page in the end, its <body ...> and what stood on the console, of a page with this text, written to `path`.

    look: JavaScript that returns what goes into the body's data (or nothing yet), 30 times a second.
    enough: JavaScript that tells from `found` whether that will do. before: JavaScript that is run once, first.
    """
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Late)
    server.enough = threading.Event()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    port = server.server_port
    path.write_text(text.replace("</body>", WATCHED % (before, look, enough, port, port)))
    words = [BROWSER, *SWITCHES.split(), "--window-size=900,600", "--dump-dom", path.as_uri()]
    try:
        ran = subprocess.run(words, capture_output=True, text=True, timeout=2 * PATIENCE)
    finally:
        server.enough.set()
        server.shutdown()
    said = [line for line in ran.stderr.splitlines() if "CONSOLE" in line and f":{port}/" not in line]
    return ran.stdout, re.search(r"<body[^>]*>", ran.stdout).group(0), said
