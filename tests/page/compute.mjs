// Answers one JSON question per line of standard input: what the page's own code computes. It runs in a folder with it.

import { createInterface } from "node:readline";
import { Calculator } from "./calculator.js";
import { fullNoise, legMoments } from "./elements.js";

const ANSWERS = {
  element: ({ turn, length, noise }) => legMoments(turn, length, fullNoise(noise)),
  scene: ({ scene, at, worst }) => {
    const calculator = new Calculator(scene);
    return scene.routes.map((route) => {
      const drift = calculator.drift(scene, route);
      if (drift instanceof Error) return { error: drift.message };
      return {
        readings: scene.beacons.map((beacon) => calculator.readingsOn(route, beacon).map(({ s }) => s)),
        at: at.map((share) => drift.at(Math.min(share * drift.length, drift.length))),
        arriving: drift.N0,
        leaving: drift.N1,
        worst: worst ? drift.worst : null,
      };
    });
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const { ask, ...question } = JSON.parse(line);
  console.log(JSON.stringify(ANSWERS[ask](question)));
}
