// The forms of the page of all calls: send a request, show the reply, and fill in the ids and tokens that it holds.

const SHOWN = 20000; // characters of a reply
const KINDS = { ow: "owner", ag: "agent", ev: "evaluation", ep: "episode", su: "submission" };
const token = document.querySelector("#token");

/** Return the request of a form as URL and options of fetch. */
function request(form) {
  const { method, path, media } = form.dataset;
  const query = new URLSearchParams();
  let url = `.${path}`; // below the folder of this page, where a proxy may have put it
  for (const input of form.querySelectorAll("input[data-in]")) {
    if (input.dataset.in === "path") url = url.replace(`{${input.name}}`, encodeURIComponent(input.value));
    else if (input.value) query.set(input.name, input.value);
  }
  const headers = { Accept: "application/json, text/*;q=0.5, */*;q=0.1" };
  if (token.value) headers.Authorization = `Bearer ${token.value.trim()}`;
  const options = { method, headers, cache: "no-store" };
  if (media === "multipart/form-data") {
    options.body = new FormData();
    for (const input of form.querySelectorAll("input[data-field]")) {
      const value = input.type === "file" ? input.files[0] : input.value;
      if (value) options.body.set(input.dataset.field, value);
    }
  } else if (media) {
    headers["Content-Type"] = "application/json";
    options.body = form.querySelector("textarea").value;
  }
  return [query.size ? `${url}?${query}` : url, options];
}

/** Put a made thing's id and token into the other forms. */
function remember(reply) {
  const name = KINDS[String(reply.id).split("_")[0]];
  if (name) for (const input of document.querySelectorAll(`input[name="${name}"]`)) input.value = reply.id;
  if (typeof reply.token === "string") token.value = reply.token;
}

async function send(event) {
  event.preventDefault();
  const form = event.target;
  const status = form.querySelector("[role=status]");
  const shown = form.querySelector("pre");
  status.textContent = "Waiting for the reply …";
  try {
    const [url, options] = request(form);
    const response = await fetch(url, options);
    let text = await response.text();
    if (/json/.test(response.headers.get("Content-Type") ?? "")) {
      const reply = JSON.parse(text);
      text = JSON.stringify(reply, null, 2);
      if (response.ok) remember(reply);
    }
    status.textContent = `${response.status} ${response.statusText}`;
    shown.textContent = text.length > SHOWN ? `${text.slice(0, SHOWN)}\n… ${text.length - SHOWN} characters more` : text;
    shown.hidden = !text;
  } catch (error) {
    status.textContent = `No reply: ${error.message}`;
    shown.hidden = true;
  }
}

/** Open what the address points at. */
function open() {
  const there = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (there instanceof HTMLDetailsElement) {
    there.open = true;
    there.scrollIntoView();
  }
}

for (const form of document.querySelectorAll("form.try")) {
  form.hidden = false;
  form.addEventListener("submit", send);
}
const holder = document.querySelector("form.token");
holder.hidden = false;
holder.addEventListener("submit", (event) => event.preventDefault());
addEventListener("hashchange", open);
open();
