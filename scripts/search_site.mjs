// Search a built site as its page does: with the worker of the site's own theme, over its own index.
//
//     node scripts/search_site.mjs FOLDER "read pixels back" "uniform buffer"
//
// Prints JSON: for each query a list of results, the best first, each with its address and title.

import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import vm from "node:vm";

const [folder, ...queries] = process.argv.slice(2);
const workers = join(folder, "assets", "javascripts", "workers");
const program = readdirSync(workers).find((name) => /^search\..*\.js$/.test(name));
const index = JSON.parse(readFileSync(join(folder, "search.json"), "utf8"));

const SETUP = 0, READY = 1, QUERY = 2, RESULT = 3, FAILED = 4;
let answer;
const self = { postMessage: (message) => answer(message) };
vm.runInNewContext(readFileSync(join(workers, program), "utf8"), { self, console, Intl });

function ask(type, data, expected) {
    return new Promise((resolve, reject) => {
        answer = ({ type, data }) => (type === expected ? resolve(data) : reject(new Error(`message ${type}`)));
        self.onmessage({ data: { type, data } });
    });
}

await ask(SETUP, index, READY);
const results = {};
for (const input of queries) {
    const { items } = await ask(QUERY, { input }, RESULT);
    results[input] = items.map(({ id }) => [index.items[id].location, index.items[id].title]);
}
console.log(JSON.stringify(results, null, 1));
