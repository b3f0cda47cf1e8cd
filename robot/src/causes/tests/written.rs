//! Chains that are written down: through calls of services, and changed settings.

use super::*;

/// Asks a server on each message, and publishes its answer.
struct Asking;

struct AskingPorts {
    client: Client<u32, u32>,
    answered: Publication<u32>,
}

impl Module for Asking {
    type Ports = AskingPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<AskingPorts, SetupError> {
        let client = setup.client::<u32, u32, _>("double", STEP * 100, |_, reply, ctx| {
            ctx.publish(ctx.ports.answered, reply.result.unwrap());
        })?;
        setup.subscribe("question", |_, question: Received<'_, u32>, ctx| {
            ctx.call(ctx.ports.client, *question);
        })?;
        Ok(AskingPorts { client, answered: setup.publish("answer")? })
    }
}

/// Doubles numbers, by a factor that is a setting.
struct Doubling;

impl Module for Doubling {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.setting("factor", 2_i64, "of each number")?;
        setup.serve::<u32, u32, _>("double", |_, number, _| Ok(number * 2))
    }
}

/// Collects reports of the executor.
#[derive(Default)]
struct Reports {
    accounts: Vec<CycleRuns>,
    events: Vec<ModuleEvent>,
    settings: Vec<SettingsChange>,
}

struct Reporter(Arc<Mutex<Reports>>);

impl Module for Reporter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(ModuleEvent::TOPIC, |reporter, event: Received<'_, ModuleEvent>, _| {
            reporter.0.lock().events.push(event.clone());
        })?;
        setup.subscribe(SettingsChange::TOPIC, |reporter, change: Received<'_, SettingsChange>, _| {
            reporter.0.lock().settings.push(change.clone());
        })?;
        setup.subscribe(CycleRuns::TOPIC, |reporter, account: Received<'_, Arc<CycleRuns>>, _| {
            reporter.0.lock().accounts.push((**account).clone());
        })
    }
}

#[test]
fn a_chain_leads_through_calls_and_names_changed_settings() {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    core.add("asking", Asking).unwrap();
    core.add("doubling", Doubling).unwrap();
    let questions = core.inlet("question").unwrap();
    let reports = Arc::new(Mutex::new(Reports::default()));
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("reporter", Reporter(Arc::clone(&reports)), options).unwrap();
    core.cycle().unwrap();
    clock.advance(STEP);
    questions.publish(21_u32).unwrap();
    for cycle in 0..6 {
        if cycle == 1 {
            // Takes effect after the cycle in which the request is on its way.
            core.handle().set("doubling", "factor", 3_i64);
        }
        core.cycle().unwrap();
        clock.advance(STEP);
    }
    core.stop();
    let reports = std::mem::take(&mut *reports.lock());
    let mut history = History::default();
    reports.accounts.iter().for_each(|account| history.push(account));
    reports.events.iter().for_each(|event| history.push_event(event));
    reports.settings.iter().for_each(|change| history.push_settings(change, None));

    let answer = history.message("answer", 0).unwrap();
    let explained = history.explain(answer, Limits::default()).unwrap();
    let From::Run(answered) = explained.from else { panic!("{explained:?}") };
    assert_eq!((&*answered.module, &answered.causes[..]), ("asking", &["response"][..]));
    let From::Run(served) = &answered.calls[0].from else { panic!("{answered:?}") };
    assert_eq!((&*served.module, &served.causes[..]), ("doubling", &["request", "setting"][..]));
    assert_eq!(answered.remembered[0].topic, "question");
    let From::Run(asked) = &served.calls[0].from else { panic!("{served:?}") };
    assert_eq!(asked.received[0].topic, "question");
    assert_eq!(asked.received[0].from, From::Outside);
    assert_eq!(served.settings, ["factor"]);

    let cut = history.explain(answer, Limits { depth: 1, ..Limits::default() }).unwrap();
    let From::Run(answered) = cut.from else { panic!("{cut:?}") };
    assert!(matches!(&answered.calls[0].from, From::Deeper { module, .. } if module == "doubling"));

    let mut latency = Latency::new("question", "answer");
    let mut events = reports.events.iter().peekable();
    for account in &reports.accounts {
        while let Some(event) = events.next_if(|event| event.cycle < account.cycle) {
            latency.event(event);
        }
        latency.account(account);
    }
    let samples: Vec<_> = latency.take_samples().collect();
    assert_eq!(samples.iter().map(|sample| sample.age).collect::<Vec<_>>(), [STEP * 3]);
    let way: Vec<_> = samples[0].hops().iter().map(|hop| format!("{} by {}", hop.module, hop.by)).collect();
    // The caller still has what the server was asked for.
    assert_eq!(way, ["asking by question"]);
}

#[test]
fn ages_are_counted_by_messages() {
    let ms = Duration::from_millis;
    let ages = Ages::new([(ms(3), 1), (ms(1), 98), (ms(2), 1)]);
    assert_eq!(ages.count(), 100);
    let quantiles = [0.0, 0.5, 0.98, 0.99, 1.0].map(|share| ages.quantile(share));
    assert_eq!(quantiles, [ms(1), ms(1), ms(1), ms(2), ms(3)].map(Some));
    assert_eq!(Ages::default().quantile(0.5), None);
}
