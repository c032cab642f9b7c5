// Drive a suite by types that openapi-typescript makes of the service's own description, and openapi-fetch.
//
// Start a service (wrongturn serve), then, beside a copy of this file:
//
//     npm pkg set type=module
//     npm install openapi-fetch openapi-typescript typescript@5 @types/node
//     npx openapi-typescript http://127.0.0.1:8000/openapi.json -o wrongturn.d.ts --default-non-nullable false
//     npx tsc --strict --module nodenext --target es2022 --skipLibCheck generated_client.ts
//     node generated_client.js http://127.0.0.1:8000 my-typed-agent

import { argv } from "node:process";
import createClient from "openapi-fetch";
import type { components, paths } from "./wrongturn.js";

type Schemas = components["schemas"];
type Observation = Schemas["StepReply"]["observation"];

/** Follows the lane and the commanded exit at 5 m/s; where there is no such exit, takes another. */
class Driver {
  private path: number[][] = [];
  private chosen = false;

  /** Steers for a point of the path 4 m ahead of the rear axle (pure pursuit). */
  act(seen: Observation): Schemas["Action"] {
    if (!("pose" in seen)) throw new Error("drive in the privileged track");
    if (!this.chosen) {
      const open = seen.exits.filter((_, i) => seen.exits_mask[i]);
      if (seen.exits_mask[seen.command - 1]) open.unshift(seen.exits[seen.command - 1]);
      this.path = [...seen.lane, ...(open[0] ?? [])];
      this.chosen = 0 <= seen.stop_line && seen.stop_line < 1;
    }
    const yaw = seen.pose[2];
    const [x, y] = [seen.pose[0] - 1.45 * Math.cos(yaw), seen.pose[1] - 1.45 * Math.sin(yaw)];
    const away = this.path.map((point) => Math.hypot(point[0] - x, point[1] - y));
    const nearest = away.indexOf(Math.min(...away));
    const found = away.findIndex((distance, i) => i >= nearest && distance > 4);
    const goal = found < 0 ? away.length - 1 : found;
    const [dx, dy] = [this.path[goal][0] - x, this.path[goal][1] - y];
    const aside = Math.cos(yaw) * dy - Math.sin(yaw) * dx;
    const wheel = Math.atan((5.8 * aside) / Math.max(away[goal], 1) ** 2);
    const between = (low: number, value: number, high: number) => Math.max(low, Math.min(high, value));
    const push = 5 - seen.speed;
    const steer = between(-1, (-wheel * 180) / Math.PI / 35, 1);
    return { steer, throttle: between(0, push, 1), brake: between(0, -push, 1) };
  }
}

/** The reply's message; a problem ends the program. */
function told<T>(reply: { data?: T; error?: Schemas["Problem"] }): T {
  if (reply.data === undefined) throw new Error(reply.error?.detail);
  return reply.data;
}

const [url, name, suite = "smoke@3"] = argv.slice(2);
const client = createClient<paths, "application/json" | "application/problem+json">({ baseUrl: url }); // not CSV
const agent = told(await client.POST("/v1/agents", { body: { name, track: "privileged" } }));
client.use({
  onRequest({ request }) {
    request.headers.set("Authorization", `Bearer ${agent.token}`);
  },
});
const begun = told(await client.POST("/v1/evaluations", { body: { suite } }));
const evaluation = { params: { path: { evaluation: begun.id } } };
for (;;) {
  const reset = await client.POST("/v1/evaluations/{evaluation}/episodes", evaluation);
  if (reset.error?.type === "/problems/evaluation-finished") break;
  const { id, observation } = told(reset);
  const driver = new Driver();
  let seen: Observation = observation;
  for (let seq = 1, over = false; !over; seq++) {
    const body = { seq, action: driver.act(seen) };
    const step = told(await client.POST("/v1/episodes/{episode}/step", { params: { path: { episode: id } }, body }));
    seen = step.observation;
    over = step.terminated || step.truncated;
  }
}
console.log(told(await client.GET("/v1/evaluations/{evaluation}", evaluation)).state);
const { entries } = told(await client.GET("/v1/leaderboards/{suite}", { params: { path: { suite } } }));
console.log(`rank ${entries.find((entry) => entry.agent.name === name)?.rank}`);
