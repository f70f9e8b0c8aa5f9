// An independent VDA 5050 master control (vda-5050-lib), driven by a bench.
//
//   node master.js BROKER_URL FIRST COUNT MAP_ID CELLS
//
// It has COUNT orders, from number FIRST. CELLS: JSON, [[x, y], ...] in metres; order k goes from one to
// another. Each vehicle that is online gets one order at a time. An order that no state shows after a
// while is sent again, as a master does whose broker may have lost it. One JSON line an event.
const { MasterController, Topic, BlockingType } = require("vda-5050-lib");
const [url, first, count, mapId, cellsText] = process.argv.slice(2);
const cells = JSON.parse(cellsText);
const say = (event) => console.log(JSON.stringify(event));
const master = new MasterController(
    { interfaceName: "uagv", transport: { brokerUrl: url, reconnectPeriod: 300 }, vdaVersion: "2.0.0" }, {});

function order(number) {
    const id = `order-${number}`;
    const node = (name, sequenceId, place, actionType) => ({
        nodeId: `${id}-${name}`, sequenceId, released: true,
        nodePosition: { x: place[0], y: place[1], mapId },
        actions: [{ actionId: `${id}-${actionType}`, actionType, blockingType: BlockingType.Hard }],
    });
    const from = cells[number % cells.length];
    const to = cells[(number * 7 + 3) % cells.length];
    return {
        orderId: id, orderUpdateId: 0,
        nodes: [node("a", 0, from, "pick"), node("b", 2, to, "drop")],
        edges: [{ edgeId: `${id}-e`, sequenceId: 1, released: true, startNodeId: `${id}-a`,
                  endNodeId: `${id}-b`, actions: [] }],
    };
}

const waiting = Array.from({ length: Number(count) }, (_, k) => Number(first) + k);
const busy = new Map();  // serial number -> what it does
const online = new Set();
let done = 0;

function give(agvId) {
    const serial = agvId.serialNumber;
    if (busy.has(serial) || !online.has(serial) || waiting.length === 0) return;
    const number = waiting.shift();
    const job = { number, order: order(number), seen: false, agvId };
    busy.set(serial, job);
    say({ given: number, to: serial });
    master.assignOrder(agvId, job.order, {
        onOrderProcessed: (error, byCancelation, active) => {
            if (active) return;
            if (error) { say({ failed: number, why: error.errorDescription }); waiting.push(number); }
            else { done += 1; say({ done: number, by: serial }); }
            busy.delete(serial);
            if (done === Number(count)) { say({ all: done }); }
            setImmediate(() => give(agvId));
        },
    }).catch((error) => { say({ unsent: number, why: String(error) }); });
}

(async () => {
    await master.start();
    await master.subscribe(Topic.State, {}, (state, agvId) => {
        const job = busy.get(agvId.serialNumber);
        if (job && state.orderId === job.order.orderId) job.seen = true;
    });
    await master.trackAgvs((agvId, state) => {
        if (agvId.manufacturer !== "Headland") return;  // vehicles of others have a master
        if (state === "ONLINE") online.add(agvId.serialNumber); else online.delete(agvId.serialNumber);
        say({ vehicle: agvId.serialNumber, state });
        give(agvId);
    });
    setInterval(() => {
        for (const job of busy.values()) {
            if (!job.seen) { say({ again: job.number }); master.publish(Topic.Order, job.agvId, job.order).catch(() => {}); }
        }
    }, 3000);
})();
