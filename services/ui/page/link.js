// The link to the service: the stream of snapshots, requests, and the token.

const PAGE = crypto.getRandomValues(new Uint32Array(2)).join("-");
const SIGN_OF_LIFE_MS = 700;
const KEPT = "tangent-token";

let token = takeToken();

// A token in the address is kept for this tab, and removed from the address.
function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(KEPT, given);
    history.replaceState(null, "", location.pathname + location.search);
  }
  return sessionStorage.getItem(KEPT) ?? "";
}

export function setToken(given) {
  token = given.trim();
  if (token) sessionStorage.setItem(KEPT, token);
  else sessionStorage.removeItem(KEPT);
}

export const hasToken = () => token !== "";

function headers(more = {}) {
  return token ? { ...more, Authorization: `Bearer ${token}` } : more;
}

export async function get(path) {
  return fetch(path, { headers: headers() });
}

// Sends JSON; the answer is { done, message }. Rejects if the service cannot be reached.
export async function post(path, body, patience_ms = 10000) {
  const answer = await fetch(path, {
    method: "POST",
    headers: headers({ "Content-Type": "application/json" }),
    body: JSON.stringify(body),
    signal: AbortSignal.timeout(patience_ms),
    keepalive: true,
  });
  if (answer.status === 204) return { done: true, message: "" };
  const read = await answer.json();
  return { ...read, status: answer.status };
}

// Calls `take` with each snapshot, and connects again for ever. `told` is called with the reason
// when the service refuses the stream. Snapshots that wait together are skipped: only the newest
// counts. The sign of life goes out only while snapshots come in.
export async function follow(take, told) {
  let lived = 0;
  for (;;) {
    try {
      const answer = await get("/api/stream");
      if (!answer.ok) {
        told((await answer.json()).message);
      } else {
        const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
        let text = "";
        for (;;) {
          const { value, done } = await reader.read();
          if (done) break;
          text += value;
          const end = text.lastIndexOf("\n\n");
          if (end < 0) continue;
          const begin = text.lastIndexOf("data: ", end) + 6;
          const newest = text.slice(begin, end);
          text = text.slice(end + 2);
          take(JSON.parse(newest));
          if (performance.now() - lived > SIGN_OF_LIFE_MS) {
            lived = performance.now();
            post("/api/here", { page: PAGE }, 2000).catch(() => {});
          }
        }
      }
    } catch {
      // The page shows the age of the newest snapshot; here is nothing more to say.
    }
    await new Promise((again) => setTimeout(again, 700));
  }
}
