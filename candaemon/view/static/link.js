// The WebSocket to the server: keeps it, opens it again, confirms what has come.

const SHORTEST_MS = 300, LONGEST_MS = 5000;

export class Link {
  // take(message): every message. changed(open): whether the server is there.
  constructor(take, changed) {
    this.take = take;
    this.changed = changed;
    this.wait = SHORTEST_MS;
    this.token = rememberedToken();
    this.open();
  }

  open() {
    const address = new URL("live", location.href);
    address.protocol = "ws:";
    address.hash = "";
    address.search = this.token ? `?token=${encodeURIComponent(this.token)}` : "";
    const socket = this.socket = new WebSocket(address);
    socket.onopen = () => {
      this.wait = SHORTEST_MS;
      this.changed(true);
    };
    socket.onmessage = (event) => {
      const message = JSON.parse(event.data);
      try {
        this.take(message);
      } finally {  // who confirms nothing is dropped
        if (message.n) this.say({do: "shown", n: message.n});
      }
    };
    socket.onclose = () => {
      this.changed(false);
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_MS);
    };
  }

  say(command) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }
}

// The token leaves the address line, where it could be read over a shoulder, and lasts as long as the tab.
function rememberedToken() {
  const query = new URLSearchParams(location.search);
  const token = query.get("token") ?? sessionStorage.getItem("token") ?? "";
  if (query.has("token")) {
    sessionStorage.setItem("token", token);
    history.replaceState(null, "", location.pathname + location.hash);
  }
  return token;
}
